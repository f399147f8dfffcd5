"""The 6-DOF Kinova Jaco (j2n6s300) with its three-finger hand.

Kinematics, masses, meshes and limits are those of dm-control's ``third_party/kinova``
(``jaco_arm.xml``, ``jaco_hand.xml``, ``manipulators/kinova``); NOTICE names the licences. The
meshes are drawn and define the links' inertia; capsules fitted to them collide. Servo gains,
armature and damping are ours: dm-control's armature of 4 and 2 kg m^2 would dwarf the links' own
inertia.
"""

from __future__ import annotations

import math
from functools import cache
from importlib import resources

import mujoco

from saver_envs.robots import kinova, links
from saver_envs.robots.description import DRAWN_ONLY, Fingers, Robot
from saver_envs.robots.drives import add_arm_servos, lock_joint

FINGER_LOWER, FINGER_UPPER = 0.15, 1.35  # rad

#: Reflected rotor inertia, ours: small against the links', large enough for stiff servos (kg m^2).
ARMATURE = (0.25,) * 3 + (0.06,) * 3
#: Position servo stiffness (N m/rad). The damping ratio is 1 at the zero posture.
STIFFNESS = (3000.0,) * 3 + (500.0,) * 3
#: One input drives the hand: fingers 2 and 3 together press as much as finger 1, which faces them.
FINGER_SHARES = (1.0, 0.5, 0.5)

#: Serial chain: body, position (m), quaternion, mesh, mass (kg).
_LINKS = (
    ("link_1", (0, 0, 0.15675), (0, 0, 1, 0), "shoulder", 0.643205),
    ("link_2", (0, 0.0016, -0.11875), (0, 0, -0.707107, 0.707107), "arm", 1.16915),
    ("link_3", (0, -0.41, 0), (0, 0, 1, 0), "forearm", 0.673443),
    ("link_4", (0, 0.2073, -0.0114), (0, 0, -0.707107, 0.707107), "wrist", 0.221432),
    ("link_5", (0, -0.03703, -0.06414), (0, 0, 0.5, 0.866025), "wrist", 0.221432),
    ("link_6", (0, -0.03703, -0.06414), (0, 0, 0.5, 0.866025), None, 0.0),
)
#: Radius and half-height of the rings at the joints (m), as large as their actuators.
_RINGS = ((0.044, 0.011),) * 3 + ((0.035, 0.009),) * 3
_BASE_MASS, _HAND_MASS = 0.718306, 0.54719  # kg
_PROXIMAL_MASS, _DISTAL_MASS = 0.0255204, 0.0132655  # kg

#: Collision capsules: body, from, to, radius (m). Fitted to the meshes' extents slice by slice.
_CAPSULES = {
    "base": ("base", (0, 0, 0.04), (0, 0, 0.13), 0.041),
    "shoulder": ("link_1", (0, 0, -0.02), (0, -0.010, -0.125), 0.040),
    "upper_arm": ("link_2", (0, 0, -0.021), (0, -0.41, -0.021), 0.041),
    "forearm": ("link_3", (0, 0, -0.020), (0, 0.19, -0.013), 0.036),
    "wrist_1": ("link_4", (0, 0, -0.010), (0, -0.018, -0.062), 0.032),
    "wrist_2": ("link_5", (0, 0, -0.010), (0, -0.018, -0.062), 0.032),
    "palm": ("hand", (0, 0.001, -0.030), (0, 0.002, -0.080), 0.046),
}
#: Finger bases on the hand: position (m) and quaternion.
_FINGERS = (
    ((0.00279, 0.03126, -0.11467), (0.24396, -0.63159, -0.38818, 0.62521)),
    ((-0.02226, -0.02707, -0.11482), (0.601679, -0.254671, 0.659653, -0.37146)),
    ((0.02226, -0.02707, -0.11482), (0.659653, -0.37146, 0.601679, -0.254671)),
)
#: The tool point in the hand's frame (m), ours: on the hand's axis, where the closed fingers hold a
#: cube by the lower half of their pads. dm-control's pinch site lies 15 mm beside the axis.
_TOOL_POSITION = (0.0, 0.0, -0.183)


@cache
def _mesh_bytes() -> dict[str, bytes]:
    folder = resources.files("saver_envs.robots") / "assets" / "jaco"
    files = sorted(folder.iterdir(), key=lambda file: file.name)
    return {file.name: file.read_bytes() for file in files if file.name.endswith(".stl")}


def _add_mesh_geom(
    body: mujoco.MjsBody, mesh: str, mass: float, rgba: tuple[float, ...] = links.DARK
) -> None:
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=f"jaco_{mesh}",
        mass=mass,
        rgba=rgba,
        **DRAWN_ONLY,
    )


def _add_arm(spec: mujoco.MjSpec) -> mujoco.MjsBody:
    """Add base, six links and the hand's body; return the hand."""
    body = spec.worldbody.add_body(name="base")
    _add_mesh_geom(body, "base", _BASE_MASS)
    for index, (name, position, quaternion, mesh, mass) in enumerate(_LINKS):
        body = body.add_body(name=name, pos=position, quat=quaternion, gravcomp=1)
        links.add_hinge(body, JACO, index, ARMATURE[index])
        if mesh is not None:
            _add_mesh_geom(body, mesh, mass)
        links.add_ring(body, *_RINGS[index])
    # dm-control's models turn the hand by two half turns on the wrist.
    hand = body.add_body(name="hand", gravcomp=1)
    _add_mesh_geom(hand, "hand_3finger_main", _HAND_MASS)
    _add_mesh_geom(hand, "hand_3finger_insert", 0.0, links.LIGHT)
    hand.add_site(name=links.TOOL_SITE, pos=_TOOL_POSITION, size=(0.005, 0, 0), group=4)
    return hand


def _add_fingers(hand: mujoco.MjsBody) -> None:
    for index, (position, quaternion) in enumerate(_FINGERS, start=1):
        proximal = hand.add_body(
            name=f"finger_proximal_{index}", pos=position, quat=quaternion, gravcomp=1
        )
        name = JACO.finger_joints[index - 1]
        kinova.add_finger_hinge(proximal, name, FINGER_LOWER, FINGER_UPPER)
        _add_mesh_geom(proximal, "finger_proximal", _PROXIMAL_MASS, links.LIGHT)
        name, start, end = f"proximal_{index}", (0.005, -0.006, 0), (0.044, -0.007, 0)
        links.add_capsule(proximal, name, start, end, 0.010, pad=True)
        distal = proximal.add_body(
            name=f"finger_distal_{index}", pos=(0.044, -0.003, 0), gravcomp=1
        )
        _add_mesh_geom(distal, "finger_distal", _DISTAL_MASS, links.LIGHT)
        name, start, end = f"distal_{index}", (0, -0.004, 0), (0.036, -0.005, 0)
        links.add_capsule(distal, name, start, end, 0.008, pad=True)


def build(fingers: Fingers = Fingers.ACTUATED) -> mujoco.MjSpec:
    """Return a fresh model of the arm with hand and servos.

    :param fingers: actuated joints, or locked shut and without joints.
    :return: a specification whose world holds the body ``base``.
    """
    spec = mujoco.MjSpec()
    spec.modelname = "jaco"
    spec.compiler.degree = False
    spec.assets = _mesh_bytes()
    for file in _mesh_bytes():
        spec.add_mesh(name=f"jaco_{file.removesuffix('.stl')}", file=file)
    hand = _add_arm(spec)
    _add_fingers(hand)
    for name, (body, start, end, radius) in _CAPSULES.items():
        links.add_capsule(spec.body(body), name, start, end, radius)
    add_arm_servos(spec, JACO, STIFFNESS)
    if fingers is Fingers.ACTUATED:
        kinova.add_finger_servos(spec, JACO.finger_joints, FINGER_SHARES)
    else:
        for joint in JACO.finger_joints:
            lock_joint(spec, joint, JACO.finger_closed)
    return spec


JACO = Robot(
    name="jaco",
    build=build,
    base_body="base",
    tool_site=links.TOOL_SITE,
    arm_joints=tuple(f"joint_{index}" for index in range(1, 7)),
    finger_joints=tuple(f"finger_{index}" for index in range(1, 4)),
    # The elbow up, the tool near x = 0.45 m.
    home=(-3.27, 3.827, 1.365, -0.206, 0.791, -0.04),
    # The mechanics limit joints 2 and 3; the others are continuous.
    joint_lower=(-math.inf, 0.820305, 0.331613, -math.inf, -math.inf, -math.inf),
    joint_upper=(math.inf, 5.462881, 5.951573, math.inf, math.inf, math.inf),
    # Large actuators move joints 1 to 3, small ones joints 4 to 6 (dm-control's kinova package).
    joint_speed_limits=(math.radians(36.0),) * 3 + (math.radians(48.0),) * 3,
    joint_torque_limits=(30.5,) * 3 + (6.8,) * 3,
    finger_open=0.20,
    finger_closed=1.30,
    holds_orientation=True,
    reach=0.62,
    off_table_geoms=("base", "shoulder"),
)
"""The Kinova Jaco: six joints and a hand with three fingers."""
