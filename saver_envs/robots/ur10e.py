"""The 6-DOF Universal Robots UR10e with a padded crook, to press and to turn heavy things.

Kinematics, masses, centres of mass and inertia are the maker's ("DH Parameters for calculations of
kinematics and dynamics", universal-robots.com), as are the joints' torques ("Max. joint torques",
same site), ranges and speeds (e-Series User Manual UR10e, 5.8); it carries 12.5 kg and reaches
1.3 m. No meshes are used: the same capsules, of the chain's lengths, are drawn and collide. Servo
gains, armature, base and tool are ours.
"""

from __future__ import annotations

import math
from typing import Final

import mujoco
import numpy as np

from saver_envs.robots import links
from saver_envs.robots.description import Fingers, Robot
from saver_envs.robots.drives import add_arm_servos

#: Payload (kg) and reach (m), the maker's.
PAYLOAD, REACH = 12.5, 1.3

#: Denavit-Hartenberg table: a (m), d (m), alpha (rad) of the frame at the end of each link.
DH: Final = (
    (0.0, 0.1807, math.pi / 2),
    (-0.6127, 0.0, 0.0),
    (-0.57155, 0.0, 0.0),
    (0.0, 0.17415, math.pi / 2),
    (0.0, 0.11985, -math.pi / 2),
    (0.0, 0.11655, 0.0),
)
#: Of each link: mass (kg), and in the frame at its end centre of mass (m) and inertia about it
#: (kg m^2: xx, yy, zz, xy, xz, yz).
INERTIA: Final = (
    (7.369, (0.021, 0, 0.027), (0.0341, 0.0353, 0.0216, 0, -0.0043, 0.0001)),
    (13.051, (0.38, 0, 0.158), (0.0281, 0.7707, 0.7694, 0.0001, -0.0156, 0)),
    (3.989, (0.24, 0, 0.068), (0.0101, 0.3093, 0.3065, 0.0001, 0.0092, 0)),
    (2.1, (0, 0.007, 0.018), (0.0030, 0.0022, 0.0026, 0, 0, -0.0002)),
    (1.98, (0, 0.007, 0.018), (0.0030, 0.0022, 0.0026, 0, 0, -0.0002)),
    # Printed as 0, 0.0004 and 0.0003, which no body can have: a disc's instead.
    (0.615, (0, 0, -0.026), (0.0004, 0.0004, 0.0006, 0, 0, 0)),
)
_BASE_MASS = 4.4  # kg: the arm's 33.5 kg less those of the links

#: Reflected rotor inertia, ours (kg m^2).
ARMATURE = (1.0, 1.0, 0.5, 0.1, 0.1, 0.1)
#: Position servo stiffness (N m/rad): a joint that is 1/80 rad off gets all of its torque. The
#: damping ratio is 1 at the zero posture.
STIFFNESS = (26400.0, 26400.0, 12000.0, 4500.0, 4500.0, 4500.0)

#: Capsules, drawn and collided with: body, from, to, radius (m).
_CAPSULES = {
    "base": ("base", (0, 0, 0.08), (0, 0, 0.10), 0.080),
    "shoulder": ("link_1", (0, 0, 0.15), (0, 0, 0.1807), 0.075),
    "upper_arm_root": ("link_2", (0, 0, 0.03), (0, 0, 0.176), 0.072),
    "upper_arm": ("link_2", (0, 0, 0.176), (-0.6127, 0, 0.176), 0.060),
    "elbow": ("link_3", (0, 0, 0.06), (0, 0, 0.15), 0.060),
    "forearm": ("link_3", (0, 0, 0.045), (-0.57155, 0, 0.045), 0.050),
    "wrist_1": ("link_4", (0, 0, 0.08), (0, 0, 0.17415), 0.048),
    "wrist_2": ("link_5", (0, 0, 0.02), (0, 0, 0.11985), 0.046),
    "wrist_3": ("link_6", (0, 0, 0.06), (0, 0, 0.09), 0.044),
}
#: The tool, a crook: a padded bar, across the hand, ahead of the flange and below it, on a slanting
#: stem. It reaches under what it turns, and the stem keeps clear. Lengths, radii (m), mass (kg).
_AHEAD, _BELOW, _STEM_RADIUS = 0.10, 0.07, 0.015
BAR_HALF, BAR_RADIUS, _TOOL_MASS = 0.035, 0.015, 0.5


def _turn(angle: float) -> tuple[float, float, float, float]:
    """Return the quaternion of a turn about x, radians."""
    return math.cos(angle / 2), math.sin(angle / 2), 0.0, 0.0


def _set_inertia(body: mujoco.MjsBody, index: int) -> None:
    """Give a link its mass; the link's body stands in the frame at its beginning."""
    mass, centre, (xx, yy, zz, xy, xz, yz) = INERTIA[index]
    a, d, alpha = DH[index]
    cosine, sine = math.cos(alpha), math.sin(alpha)
    rotation = np.array([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]])
    tensor = rotation @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ rotation.T
    body.mass, body.ipos = mass, np.array([a, 0, d]) + rotation @ centre
    body.fullinertia = tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    body.explicitinertial = True


def _add_arm(spec: mujoco.MjSpec) -> mujoco.MjsBody:
    """Add base, six links and the tool's body; return the tool."""
    body = spec.worldbody.add_body(name="base")
    body.mass, body.ipos, body.inertia = _BASE_MASS, (0, 0, 0.04), (0.02, 0.02, 0.02)
    body.explicitinertial = True
    # With joint 1 at 0, the stretched arm points along x.
    place, turn = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
    for index, (a, d, alpha) in enumerate(DH):
        body = body.add_body(name=f"link_{index + 1}", pos=place, quat=turn, gravcomp=1)
        _set_inertia(body, index)
        links.add_hinge(body, UR10E, index, ARMATURE[index])
        place, turn = (a, 0.0, d), _turn(alpha)
    return body.add_body(name="hand", pos=place, quat=turn, gravcomp=1)


def _add_tool(hand: mujoco.MjsBody) -> None:
    hand.mass, hand.ipos = _TOOL_MASS, (_AHEAD / 2, 0, _BELOW / 2)
    hand.inertia, hand.explicitinertial = (0.0015, 0.0018, 0.0010), True
    middle, right, left = ((_AHEAD, y, _BELOW) for y in (0.0, -BAR_HALF, BAR_HALF))
    links.add_capsule(hand, "stem", (0, 0, 0), middle, _STEM_RADIUS, drawn=links.LIGHT)
    links.add_capsule(hand, "bar", right, left, BAR_RADIUS, pad=True, drawn=links.DARK)
    # The hand points along its z axis: upside down, the tool's axes are parallel to the base's.
    down = _turn(math.pi)
    hand.add_site(name=links.TOOL_SITE, pos=middle, quat=down, size=(0.005, 0, 0), group=4)


def build(fingers: Fingers = Fingers.LOCKED) -> mujoco.MjSpec:
    """Return a fresh model of the arm with tool and servos.

    :param fingers: makes no difference: the tool has none.
    :return: a specification whose world holds the body ``base``.
    """
    spec = mujoco.MjSpec()
    spec.modelname = "ur10e"
    spec.compiler.degree = False
    _add_tool(_add_arm(spec))
    for name, (body, start, end, radius) in _CAPSULES.items():
        links.add_capsule(spec.body(body), name, start, end, radius, drawn=links.LIGHT)
    add_arm_servos(spec, UR10E, STIFFNESS)
    return spec


UR10E = Robot(
    name="ur10e",
    build=build,
    base_body="base",
    tool_site=links.TOOL_SITE,
    arm_joints=(*("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"),),
    finger_joints=(),
    home=(-0.2514, -1.5096, 1.9347, -1.9959, -1.5708, -1.8222),
    # Links meet where the elbow is bent by more than half a turn.
    joint_lower=tuple(math.radians(-one) for one in (360, 360, 180, 360, 360, 360)),
    joint_upper=tuple(math.radians(one) for one in (360, 360, 180, 360, 360, 360)),
    joint_speed_limits=tuple(math.radians(one) for one in (120, 120, 180, 180, 180, 180)),
    joint_torque_limits=(330.0, 330.0, 150.0, 56.0, 56.0, 56.0),
    finger_open=0.0,
    finger_closed=0.0,
    holds_orientation=True,
    reach=1.1,
    off_table_geoms=("base", "shoulder"),
    grid_lower=(0.35, -0.80, 0.02),
    grid_upper=(1.15, 0.80, 0.70),
    tool=(
        f"a padded bar of {2000 * (BAR_HALF + BAR_RADIUS):g} x {2000 * BAR_RADIUS:g} mm, ahead of "
        "the flange on a slanting stem, ours"
    ),
)
"""The Universal Robots UR10e: six strong joints, and a bar to press with."""
