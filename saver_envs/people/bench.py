"""A person on a stretcher between two arms, under the camera of Table 8.1.

The stretcher's top is level with the plane on which the arms stand: the person's arms can be pushed
off and onto it, and lie where the robots push cubes in the other scenes. Head, legs and pelvis are
one rigid part, since the task does not move them against each other; the trunk slides, turns and
bends against friction, and the arms move at shoulder, elbow and wrist.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.cameras.rgbd import BENCH_POSE, KINECT_V2
from saver_envs.people.bodies import BODIES, arm_of
from saver_envs.people.manikin import (
    MASS_SHARE,
    SIDES,
    TRUNK_FRICTION,
    add_manikin,
    segment,
    total_mass,
)
from saver_envs.people.stretcher import add_stretcher
from saver_envs.scenes import COLLISION, Arms, Scene, add_contact_sensor, add_target

#: Name of the RGB-D camera.
CAMERA: Final = "kinect"
#: Middle between the hip joints where the scene is compiled (m); SPEC 5.6 varies it.
HIPS: Final = (0.35, 0.0, 0.0)
#: The table under a whole person: from behind a base to before it (m).
TABLE_DEPTH: Final = (-0.95, 1.55)
#: Segments that the task does not move.
RIGID: Final = ("head", "thigh", "shank", "foot")
#: Arm i pushes the person's arm at its side: the first base stands at -y, on the right.
SIDE_OF_ARM: Final = ("right", "left")
#: Joints that move the trunk: along x, along y, its turn.
TRUNK_JOINTS: Final = ("slide_x", "slide_y", "turn")
#: Geoms whose contact counts as pressing the torso.
TORSO_GEOMS: Final = ("pelvis_0", "torso_0", "torso_1")
#: Mean distance of the chest's weight from where the trunk bends (m): its lever of friction.
_CHEST_LEVER: Final = 0.2
#: Number of contacts between two bodies whose forces are summed, the strongest ones.
_CONTACTS: Final = 3
#: Radius of the marks that show targets (m).
_TARGET_RADIUS: Final = 0.028
#: First part of the names of sensors that measure forces on the torso.
_FORCE: Final = "force_"


def limb_geoms() -> list[str]:
    """Return the names of the geoms of the person's arms."""
    return [f"{side}_{part}_0" for side in SIDES for part in ("upper_arm", "forearm", "hand")]


def add_person(spec: mujoco.MjSpec, arms: Arms, body: int, decorated: bool) -> None:
    """Add camera, person, stretcher, targets, and the sensors on the person.

    :param spec: of a scene with two arms.
    :param arms: the arms.
    :param body: which of :data:`saver_envs.people.bodies.BODIES`.
    :param decorated: whether to add skins and a stretcher, which are only drawn.
    """
    KINECT_V2.add_to(spec, CAMERA, BENCH_POSE)
    appearance = BODIES[body]
    add_manikin(spec, appearance, HIPS, rigid=RIGID, skins=decorated)
    for name in limb_geoms():
        # Their friction, of cloth and skin, takes precedence over that of pads and stretcher.
        spec.geom(name).priority = 1
    for side in SIDES:  # hands lie flat, in line with the forearms
        spec.body(f"{side}_hand").quat = arm_of(appearance, side).straightened
    if decorated:
        add_stretcher(spec, appearance=appearance, position=HIPS)
    chest = total_mass(appearance) * (MASS_SHARE["torso"] + MASS_SHARE["head"])
    # The planar joints carry the chest; this is the friction of its weight on the stretcher.
    spec.joint("torso").frictionloss = TRUNK_FRICTION * chest * 9.81 * _CHEST_LEVER
    for index in range(2):
        add_target(spec, index, _TARGET_RADIUS, (0.4, 0.1 * index, _TARGET_RADIUS))
    _add_collision_counters(spec, arms)
    _add_sensors(spec, arms)


def _add_collision_counters(spec: mujoco.MjSpec, arms: Arms) -> None:
    """Count contacts between arms, and of arms with the table and with the person.

    Contact of an arm with the person's arm at its side does not count.
    """
    body, geom = mujoco.mjtObj.mjOBJ_XBODY, mujoco.mjtObj.mjOBJ_GEOM
    bases = [arms.body(index) for index in range(2)]
    add_contact_sensor(spec, f"{COLLISION}arms", bases[0], body, bases[1])
    trunk = (*RIGID, "pelvis", "torso")
    names = [one.name for one in spec.geoms]
    elsewhere = [name for name in names if segment(name.rpartition("_")[0]) in trunk]
    for index, base in enumerate(bases):
        name = f"{COLLISION}arm{index}"
        add_contact_sensor(spec, f"{name}_table", base, geom, "table")
        stranger = f"{SIDE_OF_ARM[1 - index]}_upper_arm"
        add_contact_sensor(spec, f"{name}_{stranger}", base, body, stranger)
        for other in elsewhere:
            add_contact_sensor(spec, f"{name}_{other}", base, geom, other)


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
    # The robots' arms press it directly, or through the person's own arms.
    pressing = [arms.body(index) for index in range(2)]
    pressing += [f"{side}_forearm" for side in SIDES]
    kind, strongest_first = mujoco.mjtObj.mjOBJ_GEOM, 2
    reading = (1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE), strongest_first, _CONTACTS)
    for body in pressing:
        for geom in TORSO_GEOMS:
            add_contact_sensor(spec, f"{_FORCE}{body}_{geom}", body, kind, geom, reading)


class PersonAddresses:
    """Addresses of the person in a scene's models, which differ only in the person's body.

    :param scene: that :func:`add_person` made.
    """

    def __init__(self, scene: Scene) -> None:
        model = scene.model

        def qpos(name: str) -> NDArray[np.intp]:
            return np.array([model.joint(f"{side}_{name}").qposadr[0] for side in SIDE_OF_ARM])

        def sites(name: str) -> NDArray[np.intp]:
            return np.array([model.site(f"joint_{side}_{name}").id for side in SIDE_OF_ARM])

        #: (bodies, arms) geometry of the arm that arm i of the scene pushes.
        self.arms = tuple(tuple(arm_of(body, side) for side in SIDE_OF_ARM) for body in BODIES)
        #: (3,) of the trunk: along x, along y, its turn.
        self.trunk_qpos = np.array([model.joint(name).qposadr[0] for name in TRUNK_JOINTS])
        #: (arms, 4) quaternions.
        self.shoulder_qpos = qpos("upper_arm")[:, None] + np.arange(4)
        #: (arms,).
        self.elbow_qpos = qpos("forearm")
        #: (arms,).
        self.wrist_site = sites("wrist")
        #: (arms,).
        self.elbow_site = sites("elbow")
        #: (arms,) of the hip joint at that arm's side.
        self.hip_site = sites("hip")
        #: Between the shoulders.
        self.neck_site = model.site("joint_neck").id
        starts = [
            [model.sensor(f"velocity_{side}_{part}").adr[0] for part in ("wrist", "elbow")]
            for side in SIDE_OF_ARM
        ]
        #: (arms, 2, 3) addresses of the velocities of wrist and elbow.
        self.velocity_sensor = np.array(starts, dtype=np.intp)[..., None] + np.arange(3)
        forces = [
            model.sensor_adr[index] + 3 * contact  # the normal comes first of the three
            for index in range(model.nsensor)
            if model.sensor(index).name.startswith(_FORCE)
            for contact in range(_CONTACTS)
        ]
        #: Addresses of the normal forces on the torso.
        self.force_sensor = np.array(forces, dtype=np.intp)
        #: Geoms whose friction with what they touch varies.
        self.limb_geoms = np.array([model.geom(name).id for name in limb_geoms()])
        limbs = np.isin(model.dof_bodyid, model.geom_bodyid[self.limb_geoms])
        #: Degrees of freedom whose friction and damping vary.
        self.limb_dofs = np.flatnonzero(limbs)


#: The addresses of a scene, looked up once.
person_addresses = lru_cache(maxsize=8)(PersonAddresses)
