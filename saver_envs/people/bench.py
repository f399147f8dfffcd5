"""A person on a stretcher between two arms, under the camera of Table 8.1.

The stretcher's top is level with the plane on which the arms stand: an arm of the person's can be
pushed off and onto it, and lies where the arms' hands push cubes in the other scenes. Head, legs
and pelvis are one rigid part, since nothing of the task moves them against each other; the trunk
slides, turns and bends against friction, the arms move at shoulder, elbow and wrist.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.cameras.rgbd import BENCH_POSE, KINECT_V2
from saver_envs.people.bodies import BODIES, PersonArm, arm_of
from saver_envs.people.manikin import (
    MASS_SHARE,
    SIDES,
    TRUNK_FRICTION,
    add_manikin,
    total_mass,
)
from saver_envs.people.stretcher import add_stretcher
from saver_envs.scenes import COLLISION, Arms, Scene, add_contact_counters, add_target

#: Name of the RGB-D camera.
CAMERA: Final = "kinect"
#: Middle between the hip joints where the scene is compiled (m); SPEC 5.6 varies it.
HIPS: Final = (0.35, 0.0, 0.0)
#: The table under a whole person: from behind a base to before it (m).
TABLE_DEPTH: Final = (-0.95, 1.55)
#: Segments that nothing of the task moves.
RIGID: Final = ("head", "thigh", "shank", "foot")
#: Arm i pushes the arm of the person's at its side: the first base stands at -y, at the right.
SIDE_OF_ARM: Final = ("right", "left")
#: Geoms whose contact counts as pressing the torso.
TORSO_GEOMS: Final = ("pelvis_0", "torso_0", "torso_1")
#: Mean distance of the chest's weight from where the trunk bends (m): its lever of friction.
_CHEST_LEVER: Final = 0.2
#: Contacts between two bodies whose forces are added up; the strongest come first.
_CONTACTS: Final = 3
#: Size of the marks that show targets (m).
_TARGET_RADIUS: Final = 0.028
#: First part of the names of sensors that measure forces on the torso.
_FORCE: Final = "force_"


@dataclass(frozen=True)
class PersonAddresses:
    """Where to find the person in a scene's models, which differ in the person's body alone.

    :param arms: (bodies, arms) geometry of the arm that arm i of the scene pushes.
    :param trunk_qpos: (4,) of the trunk: along x, along y, its turn, how far it bends.
    :param shoulder_qpos: (arms, 4) quaternions.
    :param elbow_qpos: (arms,).
    :param hand_qpos: (arms,).
    :param wrist_site: (arms,).
    :param elbow_site: (arms,).
    :param hip_site: (arms,) of the hip joint at that arm's side.
    :param neck_site: between the shoulders.
    :param velocity_sensor: (arms, 2, 3) addresses of the velocities of wrist and elbow.
    :param force_sensor: addresses of the normal forces on the torso.
    :param limb_geoms: geoms whose friction with what they touch varies.
    :param limb_dofs: degrees of freedom whose friction and damping vary.
    """

    arms: tuple[tuple[PersonArm, ...], ...]
    trunk_qpos: NDArray[np.intp]
    shoulder_qpos: NDArray[np.intp]
    elbow_qpos: NDArray[np.intp]
    hand_qpos: NDArray[np.intp]
    wrist_site: NDArray[np.intp]
    elbow_site: NDArray[np.intp]
    hip_site: NDArray[np.intp]
    neck_site: int
    velocity_sensor: NDArray[np.intp]
    force_sensor: NDArray[np.intp]
    limb_geoms: NDArray[np.intp]
    limb_dofs: NDArray[np.intp]


def limb_geoms() -> list[str]:
    """Return the names of the geoms of the person's arms."""
    return [f"{side}_{part}_0" for side in SIDES for part in ("upper_arm", "forearm", "hand")]


def add_person(spec: mujoco.MjSpec, arms: Arms, body: int, decorated: bool) -> None:
    """Add camera, person, stretcher, targets, and the sensors on the person.

    :param spec: of a scene with two arms.
    :param arms: the arms.
    :param body: which of :data:`saver_envs.people.bodies.BODIES`.
    :param decorated: with skins and a stretcher, which are only seen.
    """
    KINECT_V2.add_to(spec, CAMERA, BENCH_POSE)
    appearance = BODIES[body]
    add_manikin(spec, appearance, HIPS, rigid=RIGID, skins=decorated)
    for name in limb_geoms():
        # Cloth and skin decide how they slide, on rubber pads as on the stretcher.
        spec.geom(name).priority = 1
    for side in SIDES:  # hands lie flat, in line with the forearms
        spec.body(f"{side}_hand").quat = arm_of(appearance, side).straightened
    if decorated:
        add_stretcher(spec, appearance=appearance, position=HIPS)
    chest = total_mass(appearance) * (MASS_SHARE["torso"] + MASS_SHARE["head"])
    # As if the chest's weight lay on the stretcher, which the planar joints of the trunk carry.
    spec.joint("torso").frictionloss = TRUNK_FRICTION * chest * 9.81 * _CHEST_LEVER
    for index in range(2):
        add_target(spec, index, _TARGET_RADIUS, (0.4, 0.1 * index, _TARGET_RADIUS))
    _add_collision_counters(spec, arms)
    _add_sensors(spec, arms)


def _add_collision_counters(spec: mujoco.MjSpec, arms: Arms) -> None:
    """Count contacts between arms, with the table, and with all of the person but the own side."""
    body, geom = int(mujoco.mjtObj.mjOBJ_XBODY), int(mujoco.mjtObj.mjOBJ_GEOM)
    bases = [arms.body(index) for index in range(2)]
    pairs = [(f"{COLLISION}arms", body, bases[0], body, bases[1])]
    own = {side: f"{side}_upper_arm" for side in SIDES}
    elsewhere = [
        one.name
        for one in spec.geoms
        if any(one.name.startswith(part) for part in ("pelvis", "torso", "head"))
        or any(f"_{part}_" in one.name for part in ("thigh", "shank", "foot"))
    ]
    for index, base in enumerate(bases):
        pairs.append((f"{COLLISION}arm{index}_table", body, base, geom, "table"))
        stranger = own[SIDE_OF_ARM[1 - index]]
        pairs.append((f"{COLLISION}arm{index}_{stranger}", body, base, body, stranger))
        pairs += [(f"{COLLISION}arm{index}_{name}", body, base, geom, name) for name in elsewhere]
    add_contact_counters(spec, pairs)


def _add_sensors(spec: mujoco.MjSpec, arms: Arms) -> None:
    """Measure velocities of wrists and elbows, and the forces on the torso."""
    for side in SIDES:
        for part in ("wrist", "elbow"):
            spec.add_sensor(
                name=f"velocity_{side}_{part}",
                type=mujoco.mjtSensor.mjSENS_FRAMELINVEL,
                objtype=mujoco.mjtObj.mjOBJ_SITE,
                objname=f"joint_{side}_{part}",
            )
    # The robots' arms press it themselves, or by way of the person's own arms.
    pressing = [arms.body(index) for index in range(2)]
    pressing += [f"{side}_forearm" for side in SIDES]
    force = int(1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE))
    strongest_first = 2
    for body in pressing:
        for geom in TORSO_GEOMS:
            spec.add_sensor(
                name=f"{_FORCE}{body}_{geom}",
                type=mujoco.mjtSensor.mjSENS_CONTACT,
                objtype=mujoco.mjtObj.mjOBJ_XBODY,
                objname=body,
                reftype=mujoco.mjtObj.mjOBJ_GEOM,
                refname=geom,
                intprm=(force, strongest_first, _CONTACTS),
            )


@lru_cache(maxsize=8)
def person_addresses(scene: Scene) -> PersonAddresses:
    """Look up the person in a scene that :func:`add_person` made."""
    model = scene.model

    def joint(name: str) -> int:
        return int(model.joint(name).qposadr[0])

    def site(name: str) -> int:
        return int(model.site(f"joint_{name}").id)

    def sensor(name: str) -> int:
        return int(model.sensor(name).adr[0])

    velocity = [
        [sensor(f"velocity_{side}_{part}") + np.arange(3) for part in ("wrist", "elbow")]
        for side in SIDE_OF_ARM
    ]
    forces = [
        model.sensor_adr[index] + 3 * contact  # the normal comes first of the three
        for index in range(model.nsensor)
        if model.sensor(index).name.startswith(_FORCE)
        for contact in range(_CONTACTS)
    ]
    limbs = [name.removesuffix("_0") for name in limb_geoms()]
    dofs = [
        model.joint(name).dofadr[0] + offset
        for name in limbs
        for offset in range(3 if name.endswith("upper_arm") else 1)
    ]
    return PersonAddresses(
        arms=tuple(tuple(arm_of(body, side) for side in SIDE_OF_ARM) for body in BODIES),
        trunk_qpos=np.array([joint(name) for name in ("slide_x", "slide_y", "turn", "torso")]),
        shoulder_qpos=np.array(
            [joint(f"{side}_upper_arm") + np.arange(4) for side in SIDE_OF_ARM], dtype=np.intp
        ),
        elbow_qpos=np.array([joint(f"{side}_forearm") for side in SIDE_OF_ARM]),
        hand_qpos=np.array([joint(f"{side}_hand") for side in SIDE_OF_ARM]),
        wrist_site=np.array([site(f"{side}_wrist") for side in SIDE_OF_ARM]),
        elbow_site=np.array([site(f"{side}_elbow") for side in SIDE_OF_ARM]),
        hip_site=np.array([site(f"{side}_hip") for side in SIDE_OF_ARM]),
        neck_site=site("neck"),
        velocity_sensor=np.array(velocity, dtype=np.intp),
        force_sensor=np.array(forces, dtype=np.intp),
        limb_geoms=np.array([model.geom(name).id for name in limb_geoms()]),
        limb_dofs=np.array(dofs, dtype=np.intp),
    )
