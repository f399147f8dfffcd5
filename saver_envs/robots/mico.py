"""The 4-DOF Kinova MICO (m1n4s200) with its two-finger hand.

Joint origins, limits, speeds, torques, masses and inertia are the maker's: ``m1n4s200.xacro``,
``kinova_finger_set.xacro`` and ``kinova_inertial.xacro`` of Kinovarobotics/kinova-ros (BSD-3). No
meshes are used: the same capsules, of the chain's lengths, are drawn and collide. Servo gains,
armature, damping and the fingers' shape are ours.

The forearm and the hand lie on one line, on which joint 4 turns. So joint 4 never moves the tool,
and with only three joints left the hand's pitch follows from its position.
"""

from __future__ import annotations

import math

import mujoco

from saver_envs.robots import kinova, links
from saver_envs.robots.description import Fingers, Robot
from saver_envs.robots.drives import add_arm_servos

#: The maker's end effector, 0.16 m along the hand: the point of the DH table (SPEC 4.1).
END_EFFECTOR_SITE = "end_effector"

FINGER_LOWER, FINGER_UPPER = 0.0, 1.40  # rad

#: Reflected rotor inertia, ours: small against the links', large enough for stiff servos (kg m^2).
ARMATURE = (0.15, 0.15, 0.15, 0.05)
#: Position servos: stiffness (N m/rad), and damping (N m s/rad) that is critical at home.
STIFFNESS, DAMPING = (3000.0, 3000.0, 2000.0, 500.0), (60.0, 61.0, 38.0, 10.0)

_HALF = math.sqrt(0.5)

#: Serial chain: body, position (m), quaternion, grey ring radius and half-height (m).
_LINKS = (
    ("link_1", (0, 0, 0.15675), (0, 0, 1, 0), (0.0415, 0.009)),
    ("link_2", (0, 0.0016, -0.11875), (0, 0, -_HALF, _HALF), (0.0415, 0.012)),
    ("link_3", (0, -0.29, 0), (0, 0, 1, 0), (0.0385, 0.012)),
    ("link_4", (0, 0.1231, -0.0086), (0, 0, -_HALF, _HALF), (0.0335, 0.008)),
)
#: The maker's cylinders, from which a link's inertia follows: mass (kg), centre of mass (m),
#: length (m), radius (m), axis (0 is x).
Cylinder = tuple[float, links.Point, float, float, int]
_INERTIA: dict[str, Cylinder] = {
    "base": (0.46784, (0, 0, 0.1255), 0.14, 0.04, 2),
    "link_1": (0.7477, (0, -0.002, -0.0605), 0.14, 0.04, 2),
    "link_2": (0.85968, (0, -0.145, -0.0076), 0.25, 0.03, 1),
    "link_3": (0.606, (0, 0.0463, -0.0065), 0.08, 0.02, 1),
    "link_4": (0.78, (0, 0, -0.06), 0.03, 0.04, 2),
}
_FINGER_INERTIA = (0.01, (0.022, 0, 0), 0.03, 0.004, 2)

#: Capsules, drawn and collided with: body, from, to, radius (m).
_CAPSULES = {
    "base": ("base", (0, 0, 0.04), (0, 0, 0.13), 0.040),
    "shoulder": ("link_1", (0, 0, -0.02), (0, -0.004, -0.119), 0.039),
    "upper_arm": ("link_2", (0, 0, -0.008), (0, -0.29, -0.008), 0.036),
    "forearm": ("link_3", (0, 0, -0.0086), (0, 0.1231, -0.0086), 0.033),
    "wrist": ("link_4", (0, 0, 0), (0, 0, -0.065), 0.031),
    "palm": ("link_4", (0, -0.021, -0.090), (0, 0.021, -0.090), 0.028),
}
#: Finger bases on the hand (m), and the turn about the hand's x axis (rad) by which a finger at
#: angle 0 leans outwards from the hand's axis. The maker's, less their 2.5 mm offset along x.
_FINGER_BASE, _FINGER_LEAN = (0.0, 0.03095, -0.11482), math.pi / 2 - 0.649262
#: The rigid distal link starts here on the proximal one (m, the maker's) and is bent inwards (rad)
#: so that the pads are parallel when they hold a 5.6 cm cube.
_KNUCKLE, _BEND = (0.044, -0.003, 0), 0.15
_DISTAL_LENGTH = 0.040  # m
#: The tool point (m): between the pads, so near their ends that they stay clear of the table when
#: the hand is at the lowest height, 0.02 m.
_TOOL_POSITION = (0.0, 0.0, -0.188)


def _set_inertia(body: mujoco.MjsBody, cylinder: Cylinder) -> None:
    mass, centre, length, radius, axis = cylinder
    across = mass * (3 * radius**2 + length**2) / 12
    inertia = [across, across, across]
    inertia[axis] = mass * radius**2 / 2
    body.mass, body.ipos, body.inertia = mass, centre, inertia
    body.explicitinertial = True


def _add_arm(spec: mujoco.MjSpec) -> mujoco.MjsBody:
    """Add base and four links; return the last, which is the hand."""
    body = spec.worldbody.add_body(name="base")
    _set_inertia(body, _INERTIA["base"])
    for index, (name, position, quaternion, ring) in enumerate(_LINKS):
        body = body.add_body(name=name, pos=position, quat=quaternion, gravcomp=1)
        _set_inertia(body, _INERTIA[name])
        links.add_hinge(body, MICO, index, ARMATURE[index])
        links.add_ring(body, *ring)
    # With the hand straight down and joints 1 and 4 at 0, this half turn makes the tool's axes
    # parallel to the base's.
    body.add_site(
        name=links.TOOL_SITE, pos=_TOOL_POSITION, quat=(0, 0, 0, 1), size=(0.005, 0, 0), group=4
    )
    body.add_site(name=END_EFFECTOR_SITE, pos=(0, 0, -0.16), size=(0.005, 0, 0), group=4)
    return body


def _add_fingers(hand: mujoco.MjsBody, fingers: Fingers) -> None:
    """Add two fingers, mirror images of one another; a positive angle closes them."""
    for index, side in enumerate((1.0, -1.0), start=1):
        x, y, z = _FINGER_BASE
        # The frame's x axis runs along the finger, its z axis is the hinge.
        lean = _FINGER_LEAN
        if fingers is Fingers.LOCKED:
            lean -= MICO.finger_closed
        along = (0.0, side * math.sin(lean), -math.cos(lean))
        across = (0.0, -side * math.cos(lean), -math.sin(lean))
        proximal = hand.add_body(name=f"finger_proximal_{index}", pos=(x, side * y, z), gravcomp=1)
        proximal.alt.type = mujoco.mjtOrientation.mjORIENTATION_XYAXES
        proximal.alt.xyaxes = (*along, *across)
        _set_inertia(proximal, _FINGER_INERTIA)
        if fingers is Fingers.ACTUATED:
            kinova.add_finger_hinge(
                proximal, MICO.finger_joints[index - 1], FINGER_LOWER, FINGER_UPPER
            )
        name = f"proximal_{index}"
        links.add_capsule(
            proximal, name, (0.004, 0, 0), _KNUCKLE, 0.010, pad=True, drawn=links.LIGHT
        )
        distal = proximal.add_body(
            name=f"finger_distal_{index}",
            pos=_KNUCKLE,
            quat=(math.cos(_BEND / 2), 0, 0, math.sin(_BEND / 2)),
            gravcomp=1,
        )
        _set_inertia(distal, _FINGER_INERTIA)
        name = f"distal_{index}"
        links.add_capsule(
            distal, name, (0, 0, 0), (_DISTAL_LENGTH, 0, 0), 0.009, pad=True, drawn=links.DARK
        )


def build(fingers: Fingers = Fingers.ACTUATED) -> mujoco.MjSpec:
    """Return a fresh model of the arm with hand and servos.

    :param fingers: actuated joints, or locked shut and without joints.
    :return: a specification whose world holds the body ``base``.
    """
    spec = mujoco.MjSpec()
    spec.modelname = "mico"
    spec.compiler.degree = False
    hand = _add_arm(spec)
    _add_fingers(hand, fingers)
    for name, (body, start, end, radius) in _CAPSULES.items():
        links.add_capsule(spec.body(body), name, start, end, radius, drawn=links.DARK)
    add_arm_servos(spec, MICO, STIFFNESS, DAMPING)
    if fingers is Fingers.ACTUATED:
        kinova.add_finger_servos(spec, MICO.finger_joints, (1.0, 1.0))
    return spec


MICO = Robot(
    name="mico",
    build=build,
    base_body="base",
    tool_site=links.TOOL_SITE,
    arm_joints=tuple(f"joint_{index}" for index in range(1, 5)),
    finger_joints=("finger_1", "finger_2"),
    # The elbow up and the hand steep, the tool at x = 0.40, z = 0.20 m.
    home=(0.0, 2.2499, 4.7966, 0.0),
    # The mechanics limit joints 2 and 3; the others are continuous.
    joint_lower=(-math.inf, math.radians(50), math.radians(35), -math.inf),
    joint_upper=(math.inf, math.radians(310), math.radians(325), math.inf),
    joint_speed_limits=tuple(math.radians(speed) for speed in (36.0, 36.0, 36.0, 48.0)),
    joint_torque_limits=(40.0, 80.0, 40.0, 20.0),
    finger_open=0.20,
    finger_closed=1.15,  # the fingertips just meet
    holds_orientation=False,
    reach=0.48,
    off_table_geoms=("base", "shoulder"),
    # Stretched out, the arm reaches 0.601 m; the nearer to that, the flatter the hand, which would
    # lie on the cube.
    hand_reach=0.565,
    shoulder_height=0.2755,
    upright_at=0.375,
    wrist_lead=0.55,
)
"""The Kinova MICO of the dissertation: four joints and a hand with two fingers."""
