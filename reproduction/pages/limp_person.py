"""Render the page about the limp person, and draw its picture."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from reproduction.page_templates import page
from saver_advisors.reporting.tables import Column, rows_table
from saver_envs.cameras.off_screen import OffScreenView
from saver_envs.people.anthropometry import DE_LEVA, TRUNK
from saver_envs.people.bed import Bed, add_bed
from saver_envs.people.contact_forces import (
    FORCE_LIMITS,
    LASTING,
    NEVER_MORE,
    TRANSIENT_FACTOR,
)
from saver_envs.people.limp_joints import PASSIVE_JOINTS, PassiveJoint
from saver_envs.people.limp_people import PEOPLE
from saver_envs.people.limp_person import LIMITS, LimpPerson, add_limp_person
from saver_envs.people.limp_sources import OURS, SOURCES
from saver_envs.people.lying import REST_MOTION, REST_TIME, LyingPosture, LyingWorld, PersonLayout
from saver_envs.people.lying_starts import ARM_STARTS, LEG_STARTS, drawn_on_side, drawn_supine
from saver_envs.people.physique import DENSITY
from saver_envs.people.postures import random_appearance
from saver_envs.people.surface import AVERAGE_MAN, Appearance
from saver_envs.world import new_world, table_around

#: Persons of the table of masses.
_MAN, _WOMAN = PEOPLE[:2]
#: Beds of the pictures; arms hang over the edge of the narrow one.
_BED, _NARROW = Bed(), Bed(width=0.66)
#: How far aside persons are laid down who roll on, m.
_ASIDE = 0.25
#: Width and height of each picture, pixels; how many are side by side.
_SIZE, _COLUMNS = (480, 360), 3
_SEED, _LEGS = 3, ("spread", "bent")


def limp_person_page() -> str:
    """Render the page.

    :return: Markdown.
    """
    model = LyingWorld(_MAN, _BED).model
    return page(
        "limp-person",
        limits={
            name: f"{least:g} to {greatest:g} {unit}".rstrip()
            for name, (least, greatest, unit) in LIMITS.items()
        },
        density=f"{DENSITY:g}",
        man=_MAN,
        woman=_WOMAN,
        masses=_masses(),
        people=_people(),
        degrees_of_freedom=model.nv,
        capsules=int((model.geom_type == int(mujoco.mjtGeom.mjGEOM_CAPSULE)).sum()),
        joints=_joints(),
        starts=_starts(),
        forces=_forces(),
        lasting=f"{LASTING:g}",
        rest_motion=f"{1000 * REST_MOTION:g}",
        rest_time=f"{REST_TIME:g}",
        friction_source=_cited("temel"),
        sources="\n".join(f"{number}. {text}" for number, text in enumerate(SOURCES.values(), 1)),
    )


def _cited(key: str) -> str:
    """Return the number of a source, or that a value is ours."""
    return OURS if key == OURS else str(list(SOURCES).index(key) + 1)


def _masses() -> str:
    """Render the segments, with the masses of a woman and of a man."""
    rows = [
        {
            "segment": name.replace("_", " "),
            "women": DE_LEVA["female"][name],
            "men": DE_LEVA["male"][name],
        }
        for name in (*TRUNK, *(one for one in DE_LEVA["male"] if one not in TRUNK))
    ]
    columns: dict[str, Column] = {
        "segment": "{segment}",
        "share of mass, women / men (%)": lambda row: (
            f"{100 * row['women'].mass:.2f} / {100 * row['men'].mass:.2f}"
        ),
        "mass (kg)": lambda row: (
            f"{_WOMAN.mass * row['women'].mass:.2f} / {_MAN.mass * row['men'].mass:.2f}"
        ),
        "length (m)": lambda row: (
            f"{_WOMAN.height * row['women'].length:.3f} / {_MAN.height * row['men'].length:.3f}"
        ),
        "centre of mass (share of length)": lambda row: (
            f"{row['women'].centre:.3f} / {row['men'].centre:.3f}"
        ),
    }
    return rows_table(rows, columns)


def _people() -> str:
    """Render the persons of the tasks."""
    columns: dict[str, Column] = {
        "sex": lambda one: str(one.sex),
        "height (m)": lambda one: f"{one.height:.2f}",
        "body mass index (kg/m²)": lambda one: f"{one.bmi:.1f}",
        "mass (kg)": lambda one: f"{one.mass:.1f}",
    }
    return rows_table(PEOPLE, columns)


def _joints() -> str:
    """Render ranges, stiffness, damping and limits of the joints."""

    def stiffness(joint: PassiveJoint) -> str:
        return ", ".join(f"{one:g}" for one in joint.stiffness)

    columns: dict[str, Column] = {
        "joint": lambda joint: f"`{joint.name}`",
        "range (degrees)": lambda joint: f"{joint.range[0]:g} to {joint.range[1]:g}",
        "rest (degrees)": lambda joint: f"{joint.rest:g}",
        "a, b, c (N m)": stiffness,
        "damping (N m s)": lambda joint: f"{joint.damping:g}",
        "limit (N m)": lambda joint: f"{joint.torque_limit:g}",
        "sources of range, stiffness, limit": lambda joint: ", ".join(
            one if one == OURS else f"[{one}]" for one in map(_cited, joint.sources)
        ),
    }
    return rows_table(PASSIVE_JOINTS, columns)


def _starts() -> str:
    """Render the ranges from which arms and legs are drawn."""
    rows = [
        {"limb": limb, "start": kind, "ranges": ranges}
        for limb, starts in (("arm", ARM_STARTS), ("leg", LEG_STARTS))
        for kind, ranges in starts.items()
    ]
    columns: dict[str, Column] = {
        "limb": "{limb}",
        "start": "{start}",
        "drawn from": lambda row: ", ".join(
            f"{name} {low:g} to {high:g}"
            for name, (low, high) in row["ranges"].items()
            if low or high
        ),
    }
    return rows_table(rows, columns)


def _forces() -> str:
    """Render the limits of force."""
    rows = [
        {
            "part": part.replace("_", " "),
            "lasting": limit,
            "brief": limit * (1 if part in NEVER_MORE else TRANSIENT_FACTOR),
        }
        for part, limit in FORCE_LIMITS.items()
    ]
    columns: dict[str, Column] = {
        "part of the body": "{part}",
        f"lasting contact (N) [{_cited('iso')}]": "{lasting:.0f}",
        "brief contact (N)": "{brief:.0f}",
    }
    return rows_table(rows, columns)


def limp_person_picture() -> NDArray[np.uint8]:
    """Draw persons at rest, one for each start.

    :return: (height, width, 3).
    """
    random = np.random.default_rng(_SEED)
    postures = {kind: drawn_supine(random, (kind, kind)) for kind in ARM_STARTS}
    postures |= {f"{kind} leg": drawn_supine(random, legs=(kind, "straight")) for kind in _LEGS}
    postures |= {side: drawn_on_side(random, side) for side in ("left", "right")}
    aside = {"left": -_ASIDE, "right": _ASIDE}  # they roll on to that side
    pictures = []
    for person, (kind, posture) in zip([*PEOPLE, _MAN], postures.items(), strict=True):
        bed = _NARROW if kind == "overhanging" else _BED
        drawn = random_appearance(random)
        look = replace(AVERAGE_MAN, skin=drawn.skin, hair=drawn.hair)
        pictures.append(_picture(person, look, posture, bed, aside.get(kind, 0.0)))
    lines = [pictures[first : first + _COLUMNS] for first in range(0, len(pictures), _COLUMNS)]
    return np.vstack([np.hstack(line) for line in lines])


def _picture(
    person: LimpPerson, look: Appearance, posture: LyingPosture, bed: Bed, aside: float
) -> NDArray[np.uint8]:
    """Draw a person who has come to rest."""
    world = LyingWorld(person, bed)
    world.laid(posture, (0.0, aside))
    spec = new_world(table_around(np.zeros((1, 3)), np.zeros(1)), height=-1.0)
    add_limp_person(spec, person, look=look)
    add_bed(spec, bed)
    _add_camera(spec)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[PersonLayout(model).qpos] = world.data.qpos[world.layout.qpos]
    mujoco.mj_forward(model, data)
    view = OffScreenView(model, "bedside", *_SIZE)
    picture: NDArray[np.uint8] = view.draw(data)
    view.close()
    return picture


def _add_camera(spec: Any) -> None:
    """Add a camera that sees the bed from its foot end, the left and above."""
    place, target = np.array([1.0, 1.25, 1.6]), np.array([0.0, 0.0, 0.05])
    back = (place - target) / np.linalg.norm(place - target)
    right = np.cross((0.0, 0.0, 1.0), back)
    right /= np.linalg.norm(right)
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.stack([right, np.cross(back, right), back], axis=1).ravel())
    spec.worldbody.add_camera(name="bedside", pos=place, quat=quaternion, fovy=48)
