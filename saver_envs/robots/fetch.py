"""The 8-DOF Fetch: torso lift and seven arm joints, its head fixed.

Model and meshes are those of the gymnasium-robotics wheel (``envs/assets/fetch``; NOTICE says under
which terms), read by path when the arm is built: the package's simulator code is not imported. The
parts that make that model a mocap puppet are removed: the weld, the base's three slides, joint
damping of 50 to 1e7, armature of 1, fingers of 4 kg. Servo gains, armature and damping are ours;
torque and speed limits are the maker's (fetch_description 0.8.3, ``robots/fetch.urdf``: effort and
velocity).
"""

from __future__ import annotations

import importlib.util
import math
import re
from functools import cache
from pathlib import Path

import mujoco

from saver_envs.robots.description import COLLISION_GROUP, VISUAL_GROUP, Fingers, Robot
from saver_envs.robots.drives import add_arm_servos, add_servo

_PREFIX = "robot0:"
_NAMES = (
    "torso_lift",
    "shoulder_pan",
    "shoulder_lift",
    "upperarm_roll",
    "elbow_flex",
    "forearm_roll",
    "wrist_flex",
    "wrist_roll",
)
BASE_BODY, GRIPPER_BODY = f"{_PREFIX}base_link", f"{_PREFIX}gripper_link"

#: A finger of the real hand, instead of the 4 kg of the puppet's (kg, kg m^2).
FINGER_MASS, FINGER_INERTIA = 0.08, 2e-5

#: Position servos, ours: stiffness (N/m, N m/rad), and reflected inertia (kg, kg m^2).
STIFFNESS = (20000.0, 1500.0, 1500.0, 800.0, 800.0, 400.0, 400.0, 200.0)
ARMATURE = (10.0, 0.3, 0.3, 0.2, 0.2, 0.1, 0.1, 0.05)
FINGER_STIFFNESS, FINGER_DAMPING, FINGER_FORCE = 500.0, 20.0, 60.0  # N/m, N s/m, N

_REMOVED_JOINTS = ("slide0", "slide1", "slide2", "head_pan_joint", "head_tilt_joint")
#: Fixed parts whose hulls overlap moving ones in every posture.
_NOT_COLLIDED = ("torso_fixed_link", "estop_link", "laser_link", "head_pan_link", "head_tilt_link")


@cache
def _files() -> tuple[dict[str, bytes], dict[str, bytes]]:
    """Model files and meshes of the wheel.

    :raises FileNotFoundError: when the wheel does not hold them.
    """
    found = importlib.util.find_spec("gymnasium_robotics")
    if found is None or found.origin is None:
        raise FileNotFoundError("the Fetch needs gymnasium-robotics, which is not installed")
    assets = Path(found.origin).parent / "envs" / "assets"
    models, meshes = assets / "fetch", assets / "stls" / "fetch"
    if not (models / "robot.xml").is_file():
        raise FileNotFoundError(f"gymnasium-robotics has no {models / 'robot.xml'}")
    xml = {name: (models / name).read_bytes() for name in ("robot.xml", "shared.xml")}
    return xml, {path.name: path.read_bytes() for path in meshes.glob("*.stl")}


def _world() -> mujoco.MjSpec:
    """Return the wheel's robot by itself."""
    xml, meshes = _files()
    world = (
        '<mujoco model="fetch"><compiler angle="radian"/>'
        '<include file="shared.xml"/><worldbody><include file="robot.xml"/></worldbody></mujoco>'
    )
    # The texture's file is not needed without its cube.
    shared = re.sub(rb'<texture name="texture_block"[^>]*>(</texture>)?', b"", xml["shared.xml"])
    spec = mujoco.MjSpec.from_string(
        world, include={"shared.xml": shared, "robot.xml": xml["robot.xml"]}, assets=meshes
    )
    joints = (spec.joint(_PREFIX + name) for name in _REMOVED_JOINTS)
    mocap = spec.body(f"{_PREFIX}mocap")
    for part in (*spec.equalities, *spec.textures, mocap, *joints, *spec.cameras):
        spec.delete(part)
    spec.body(BASE_BODY).pos = (0, 0, 0)
    return spec


def _set_joints(spec: mujoco.MjSpec, fingers: Fingers) -> None:
    for index, name in enumerate(FETCH.arm_joints):
        joint = spec.joint(name)
        joint.armature, joint.frictionloss = ARMATURE[index], 0.0
        joint.damping, joint.stiffness = (0, 0, 0), (0, 0, 0)
        limit = FETCH.joint_torque_limits[index]
        joint.actfrclimited, joint.actfrcrange, joint.actgravcomp = True, (-limit, limit), 1
    for name in FETCH.finger_joints:
        body = spec.body(name.replace("_joint", "_link"))
        body.mass, body.inertia = FINGER_MASS, (FINGER_INERTIA,) * 3
        joint = spec.joint(name)
        if fingers is Fingers.LOCKED:
            spec.delete(joint)
        else:
            joint.armature, joint.damping = 0.1, (5.0, 0, 0)


def _set_geoms(spec: mujoco.MjSpec) -> None:
    """Draw and collide with the wheel's hulls; fixed parts that always overlap are only drawn."""
    for geom in spec.geoms:
        fixed = geom.name.removeprefix(_PREFIX) in _NOT_COLLIDED
        geom.group = VISUAL_GROUP if fixed else COLLISION_GROUP
        geom.margin = 0.0
        if fixed:
            geom.contype = geom.conaffinity = 0


def build(fingers: Fingers = Fingers.ACTUATED) -> mujoco.MjSpec:
    """Return a fresh model of the robot with position servos, gravity compensated.

    :param fingers: actuated joints, or locked shut and without joints.
    :return: a specification whose world holds the body ``robot0:base_link``.
    :raises FileNotFoundError: when gymnasium-robotics is not installed.
    """
    spec = _world()
    _set_joints(spec, fingers)
    _set_geoms(spec)
    for body in spec.bodies:
        if body.name.startswith(_PREFIX):
            body.gravcomp = 1
    spec.body(GRIPPER_BODY).add_site(name=FETCH.tool_site, size=(0.005, 0, 0), group=4)
    add_arm_servos(spec, FETCH, STIFFNESS)
    if fingers is Fingers.ACTUATED:
        for joint in FETCH.finger_joints:
            add_servo(spec, joint, FINGER_FORCE, FINGER_STIFFNESS, FINGER_DAMPING)
    return spec


FETCH = Robot(
    name="fetch",
    build=build,
    base_body=BASE_BODY,
    tool_site="tool",
    arm_joints=tuple(f"{_PREFIX}{name}_joint" for name in _NAMES),
    finger_joints=tuple(f"{_PREFIX}{side}_gripper_finger_joint" for side in "rl"),
    # The hand in front of the chest, level (m, rad).
    home=(0.15, 0.0, 0.6, 0.0, 1.0, 0.0, -1.6, 0.0),
    # Metres for the lift, radians for the others; infinity where continuous.
    joint_lower=(0.0386, -1.6056, -1.221, -math.inf, -2.251, -math.inf, -2.16, -math.inf),
    joint_upper=(0.3861, 1.6056, 1.518, math.inf, 2.251, math.inf, 2.16, math.inf),
    # m/s and rad/s; N for the lift, N m for the others.
    joint_speed_limits=(0.1, 1.256, 1.454, 1.571, 1.521, 1.571, 2.268, 2.268),
    joint_torque_limits=(450.0, 33.82, 131.76, 76.94, 66.18, 29.35, 25.70, 7.36),
    finger_open=0.05,  # m
    finger_closed=0.0,
    holds_orientation=False,
    reach=0.9,
    off_table_geoms=(f"{_PREFIX}base_link", f"{_PREFIX}torso_lift_link"),
)
