"""Joints of a limp person: axes, ranges, passive stiffness and damping, greatest torques.

All angles are 0 in the lying straight posture: on the back, arms straight at the sides with the
elbows' creases up and the palms inwards, legs straight and parallel, feet at right angles. Ranges,
stiffness and limits are those of the sources named in each row, rounded; where there is none, the
value is ours. Nothing is driven: the muscles of a limp person are slack.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from saver_envs.people.manikin import SIDES

#: Centre of the shoulder's range: abduction, flexion and outward rotation, degrees. The ends of the
#: published ranges of each motion are at nearly equal turns from it, 100 degrees or little more.
SHOULDER_CENTRE: Final = (45.0, 55.0, -15.0)
_BALL: Final = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class PassiveJoint:
    """A joint without drive.

    :param name: without side.
    :param body: segment that it moves against its parent, without side.
    :param axis: of positive angles, at zero posture, of the left side; zeros for a ball. x points
        to the feet, y to the left, z to the front.
    :param range: degrees; of a ball the greatest turn from its centre.
    :param rest: angle without torque, degrees; a ball's is its centre.
    :param stiffness: coefficients of the angle from rest, of its square and of its cube: N m/rad,
        N m/rad^2 and N m/rad^3.
    :param damping: N m s/rad.
    :param torque_limit: torque against the end of the range that is not to be exceeded, N m.
    :param sources: of range, stiffness and torque limit, keys of
        :data:`saver_envs.people.limp_sources.SOURCES` or ``ours``; damping is ours.
    """

    name: str
    body: str
    axis: tuple[float, float, float]
    range: tuple[float, float]
    rest: float
    stiffness: tuple[float, float, float]
    damping: float
    torque_limit: float
    sources: tuple[str, str, str]

    @property
    def group(self) -> str:
        """The joint of the body that it belongs to: ``hip`` of ``hip_flexion``."""
        return self.name.split("_")[0]


PASSIVE_JOINTS: Final = (
    PassiveJoint(
        *(
            "spine_twist",
            "torso",
            (-1.0, 0.0, 0.0),
            (-40.0, 40.0),
            0.0,
            (12.0, 0.0, 50.0),
            3.0,
            40.0,
        ),
        ("white", "watt", "ours"),
    ),
    PassiveJoint(
        *(
            "spine_bend",
            "torso",
            (0.0, 0.0, -1.0),
            (-30.0, 30.0),
            0.0,
            (14.0, 0.0, 260.0),
            5.0,
            60.0,
        ),
        ("white", "watt", "ours"),
    ),
    PassiveJoint(
        *(
            "spine_flexion",
            "torso",
            (0.0, 1.0, 0.0),
            (-25.0, 60.0),
            0.0,
            (12.0, 0.0, 60.0),
            5.0,
            60.0,
        ),
        ("white", "watt", "ours"),
    ),
    PassiveJoint(
        *(
            "neck_rotation",
            "head",
            (-1.0, 0.0, 0.0),
            (-75.0, 75.0),
            0.0,
            (3.0, 0.0, 2.0),
            0.3,
            10.0,
        ),
        ("youdas", "ours", "mcgill"),
    ),
    PassiveJoint(
        *("neck_bend", "head", (0.0, 0.0, -1.0), (-45.0, 45.0), 0.0, (2.0, 0.0, 6.0), 0.4, 10.0),
        ("youdas", "ours", "mcgill"),
    ),
    PassiveJoint(
        *("neck_flexion", "head", (0.0, 1.0, 0.0), (-65.0, 50.0), 0.0, (2.0, 0.0, 6.0), 0.4, 10.0),
        ("youdas", "ours", "mcgill"),
    ),
    PassiveJoint(
        *("shoulder", "upper_arm", _BALL, (0.0, 105.0), 0.0, (0.5, 0.0, 0.0), 0.5, 20.0),
        ("boone", "ours", "ours"),
    ),
    PassiveJoint(
        *("elbow", "forearm", (0.0, -1.0, 0.0), (0.0, 143.0), 73.0, (0.5, 0.0, 0.0), 0.12, 10.0),
        ("boone", "wiegner", "ours"),
    ),
    PassiveJoint(
        *("wrist", "hand", (0.0, 0.0, -1.0), (-75.0, 75.0), 0.0, (0.5, 0.0, 0.0), 0.03, 4.0),
        ("boone", "ours", "ours"),
    ),
    PassiveJoint(
        *(
            "hip_flexion",
            "thigh",
            (0.0, -1.0, 0.0),
            (-10.0, 122.0),
            27.0,
            (18.0, 0.0, 0.0),
            2.0,
            40.0,
        ),
        ("boone", "riener", "ours"),
    ),
    PassiveJoint(
        *(
            "hip_abduction",
            "thigh",
            (0.0, 0.0, 1.0),
            (-27.0, 46.0),
            0.0,
            (6.0, 0.0, 0.0),
            2.0,
            40.0,
        ),
        ("boone", "ours", "ours"),
    ),
    PassiveJoint(
        *(
            "hip_rotation",
            "thigh",
            (-1.0, 0.0, 0.0),
            (-47.0, 47.0),
            15.0,
            (4.0, 0.0, 0.0),
            0.3,
            20.0,
        ),
        ("boone", "ours", "ours"),
    ),
    PassiveJoint(
        *("knee", "shank", (0.0, 1.0, 0.0), (-3.0, 142.0), 8.0, (14.5, -14.4, 4.9), 0.3, 30.0),
        ("boone", "riener", "ours"),
    ),
    PassiveJoint(
        *("ankle", "foot", (0.0, 1.0, 0.0), (-13.0, 56.0), 18.0, (10.0, 0.0, 0.0), 0.2, 20.0),
        ("boone", "riener", "ours"),
    ),
)
"""All joints, those of a body in the order in which they move it, the outermost one first."""
_CENTRAL: Final = ("torso", "head")


def joints_of(body: str) -> list[PassiveJoint]:
    """Return the joints that move a segment, from the outermost one inwards.

    :param body: without side.
    """
    return [joint for joint in PASSIVE_JOINTS if joint.body == body]


def joint_names(joint: PassiveJoint) -> Iterator[str]:
    """Yield the names of a joint in a model, of both sides if there are two."""
    if joint.body in _CENTRAL:
        yield joint.name
    else:
        yield from (f"{side}_{joint.name}" for side in SIDES)
