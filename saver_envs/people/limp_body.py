"""Shape, capsules, frames and inertia of a limp person's bodies."""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from saver_envs.people.anthropometry import (
    DE_LEVA,
    TRUNK,
    Inertia,
    Sex,
    joined_inertia,
    segment_inertia,
)
from saver_envs.people.body_parts import LIMB_PARTS, foot_ends, part_capsules
from saver_envs.people.limp_frames import zero_rotations
from saver_envs.people.manikin import NEXT_BODY
from saver_envs.people.physique import Physique

_FEETWARDS: Final = np.array([1.0, 0.0, 0.0])


class LimpBody:
    """What a person's bodies are made of, in the frames of :mod:`saver_envs.people.limp_frames`.

    :param sex: ``female`` or ``male``.
    :param height: metres.
    :param bmi: body mass index, kg/m^2.
    """

    def __init__(self, sex: Sex, height: float, bmi: float) -> None:
        shape = Physique(sex, height, bmi)
        #: The surface, with the joints' centres.
        self.shape = shape
        #: Capsules by body.
        self.capsules = part_capsules(shape)
        #: Turns (3, 3) of the bodies at zero posture.
        self.zero = zero_rotations(shape)
        #: Mass, centre of mass and inertia by body, in the frame of the mesh.
        self.inertia = _inertia(sex, height, shape)


#: The body of a person, computed once.
limp_body = lru_cache(maxsize=64)(LimpBody)


def _inertia(sex: Sex, height: float, shape: Physique) -> dict[str, Inertia]:
    """Return the inertia of every body; that of right limbs mirrors that of left ones."""
    table = DE_LEVA[sex]
    pairs = [row.mass for name, row in table.items() if name in LIMB_PARTS]
    whole = sum(row.mass for row in table.values()) + sum(pairs)
    mass = shape.mass / whole  # the published shares add up to all but 0.01%
    front = np.array([0.0, 0.0, 1.0])
    spine = _spine(sex, height, shape)
    found = {
        name: segment_inertia(table[name], mass, begin, end, front)
        for name, begin, end in zip(TRUNK, spine[:-1], spine[1:], strict=True)
    }
    found = {
        "pelvis": found["lower_trunk"],
        "torso": joined_inertia([found["upper_trunk"], found["middle_trunk"]]),
    }
    crown = shape.owned("head").min(axis=0)[0]
    level = float(np.median(shape.owned("head")[:, 2]))
    top = np.array([crown, 0.0, level])
    nape = top + table["head"].length * height * _FEETWARDS
    found["head"] = segment_inertia(table["head"], mass, top, nape, front)
    for part in LIMB_PARTS:
        begin, end = _limb_ends(shape, part)
        ahead = -_FEETWARDS if part == "foot" else front
        one = segment_inertia(table[part], mass, begin, end, ahead)
        across = np.diag([1.0, -1.0, 1.0])
        other = Inertia(one.mass, across @ one.centre, across @ one.tensor @ across)
        found |= {f"left_{part}": one, f"right_{part}": other}
    return found


def _spine(sex: Sex, height: float, shape: Physique) -> list[NDArray[np.float64]]:
    """Return C7, xiphoid, navel and the middle of the hips, (3,) each."""
    table = DE_LEVA[sex]
    level = float(np.median(shape.owned("torso")[:, 2]))
    points = [np.array([shape.head("left_thigh")[0], 0.0, level])]
    for name in reversed(TRUNK):
        points.append(points[-1] - table[name].length * height * _FEETWARDS)
    return points[::-1]


def _limb_ends(shape: Physique, part: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the ends of a left limb's segment, as the published table has them."""
    if part == "foot":
        return foot_ends(shape)
    begin = shape.head(f"left_{part}")
    if part in NEXT_BODY:
        return begin, shape.head(f"left_{NEXT_BODY[part]}")
    reach = shape.owned("left_hand") - begin
    return begin, begin + reach[np.linalg.norm(reach, axis=1).argmax()]
