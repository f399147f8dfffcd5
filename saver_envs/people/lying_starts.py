"""Random postures in which a limp person is laid down, by what tasks call for.

The ranges are ours. Gravity changes a posture further: an arm rolls, a hand slides off the chest.
Draw again what does not stay, see :class:`saver_envs.people.lying.LyingWorld`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from saver_envs.people.lying import ArmPosture, LegPosture, LyingPosture
from saver_envs.validation import require

Ranges = Mapping[str, tuple[float, float]]

#: Kind of start -> ranges of an arm's angles, degrees. On the chest lies a forearm, its elbow on
#: the bed; across the chest lies the whole arm.
ARM_STARTS: Final[Mapping[str, Ranges]] = {
    "side": {
        "abduction": (6.0, 20.0), "flexion": (0.0, 0.0), "rotation": (-45.0, 10.0),
        "elbow": (3.0, 25.0),
    },
    "abducted": {
        "abduction": (25.0, 60.0), "flexion": (0.0, 0.0), "rotation": (-60.0, 30.0),
        "elbow": (3.0, 30.0),
    },
    "apart": {
        "abduction": (24.0, 38.0), "flexion": (0.0, 0.0), "rotation": (-60.0, 30.0),
        "elbow": (3.0, 30.0),
    },
    "bent": {
        "abduction": (32.0, 45.0), "flexion": (0.0, 0.0), "rotation": (-90.0, -78.0),
        "elbow": (60.0, 85.0),
    },
    "chest": {
        "abduction": (3.0, 12.0), "flexion": (22.0, 38.0), "rotation": (-85.0, -60.0),
        "elbow": (80.0, 105.0),
    },
    "across": {
        "abduction": (-25.0, -8.0), "flexion": (50.0, 62.0), "rotation": (-90.0, -75.0),
        "elbow": (85.0, 105.0),
    },
    "overhanging": {
        "abduction": (58.0, 72.0), "flexion": (0.0, 8.0), "rotation": (-30.0, 0.0),
        "elbow": (5.0, 20.0),
    },
}  # fmt: skip
#: The same of legs. A limp bent leg stays only where it lies on its outer side, and not on a
#: slide sheet.
LEG_STARTS: Final[Mapping[str, Ranges]] = {
    "straight": {
        "flexion": (0.0, 0.0), "abduction": (0.0, 8.0), "rotation": (5.0, 40.0), "knee": (0.0, 6.0),
    },
    "spread": {
        "flexion": (0.0, 0.0), "abduction": (10.0, 25.0), "rotation": (5.0, 40.0),
        "knee": (0.0, 6.0),
    },
    "bent": {
        "flexion": (12.0, 36.0), "abduction": (8.0, 36.0), "rotation": (36.0, 47.0),
        "knee": (112.0, 128.0),
    },
    "adducted": {
        "flexion": (0.0, 0.0), "abduction": (-16.0, -8.0), "rotation": (5.0, 40.0),
        "knee": (0.0, 6.0),
    },
}  # fmt: skip
#: The same of a person on the left side, lower limbs first. A limp body does not stay on edge on a
#: flat bed: it comes to rest turned by 120 to 150 degrees, as in the recovery position.
_ROLL: Final = (88.0, 98.0)
_ARMS_ON_SIDE: Final[tuple[Ranges, Ranges]] = (
    {
        "abduction": (20.0, 60.0), "flexion": (45.0, 95.0), "rotation": (-30.0, 30.0),
        "elbow": (40.0, 100.0),
    },
    {
        "abduction": (0.0, 20.0), "flexion": (0.0, 45.0), "rotation": (-40.0, 0.0),
        "elbow": (40.0, 90.0),
    },
)  # fmt: skip
_LEGS_ON_SIDE: Final[tuple[Ranges, Ranges]] = (
    {
        "flexion": (30.0, 60.0), "abduction": (0.0, 0.0), "rotation": (0.0, 0.0),
        "knee": (40.0, 80.0),
    },
    {
        "flexion": (40.0, 70.0), "abduction": (-15.0, 0.0), "rotation": (0.0, 10.0),
        "knee": (60.0, 100.0),
    },
)  # fmt: skip
#: Turn of the head (degrees) to either side.
_HEAD_TURN: Final = 35.0


def drawn_supine(
    generator: np.random.Generator,
    arms: tuple[str, str] = ("side", "side"),
    legs: tuple[str, str] = ("straight", "straight"),
    head_turn: float = _HEAD_TURN,
) -> LyingPosture:
    """Draw a posture on the back.

    :param generator: source of randomness.
    :param arms: kinds of :data:`ARM_STARTS`, of the left and the right arm.
    :param legs: kinds of :data:`LEG_STARTS`, of the left and the right leg.
    :param head_turn: greatest turn of the head to either side, degrees.
    :raises ValueError: for an unknown kind.
    """
    for name, kinds, known in (("arms", arms, ARM_STARTS), ("legs", legs, LEG_STARTS)):
        held = len(kinds) == 2 and all(kind in known for kind in kinds)
        require(name, kinds, held, f"two of {', '.join(known)}")
    left, right = (ArmPosture(**_drawn(generator, ARM_STARTS[kind])) for kind in arms)
    first, second = (LegPosture(**_drawn(generator, LEG_STARTS[kind])) for kind in legs)
    turn = float(generator.uniform(-head_turn, head_turn))
    return LyingPosture(0.0, (left, right), (first, second), {"neck_rotation": turn})


def drawn_on_side(generator: np.random.Generator, side: str = "left") -> LyingPosture:
    """Draw a posture on one side, arms and knees bent in front.

    :param generator: source of randomness.
    :param side: ``left`` or ``right``, on which the person lies.
    :raises ValueError: for another side.
    """
    require("side", side, side in ("left", "right"), "'left' or 'right'")
    lower, upper = (ArmPosture(**_drawn(generator, ranges)) for ranges in _ARMS_ON_SIDE)
    below, above = (LegPosture(**_drawn(generator, ranges)) for ranges in _LEGS_ON_SIDE)
    roll = float(generator.uniform(*_ROLL))
    posture = LyingPosture(roll, (lower, upper), (below, above))
    return posture if side == "left" else posture.mirrored()


def _drawn(generator: np.random.Generator, ranges: Ranges) -> dict[str, float]:
    """Draw a number from each range."""
    return {name: float(generator.uniform(*ends)) for name, ends in ranges.items()}
