"""How the legs of a person lie before they are straightened, and where their ankles are to be."""

from __future__ import annotations

import math
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.people.bed import Bed
from saver_envs.people.limp_limbs import LimpLegs
from saver_envs.people.limp_people import PEOPLE
from saver_envs.people.lying import LyingWorld
from saver_envs.tasks.straighten import end_target

#: How the left and the right leg lie at the start, kinds of
#: :data:`saver_envs.people.lying_starts.LEG_STARTS`.
PAIRS: Final = (
    ("spread", "spread"),
    ("spread", "straight"),
    ("straight", "spread"),
    ("tucked", "over"),
    ("over", "tucked"),
)
#: Who is too short for a tucked leg (m): springs of the hip and the knee, which are those of taller
#: people, stretch the lighter leg.
TALL: Final = 1.75
#: Distance of an ankle's target from the person's middle line, and its height above the bed (m).
ASIDE, HEIGHT = 0.10, 0.06
#: Bend of the knee with which the ankle is at its target (rad).
_SLACK: Final = math.radians(5.0)
#: Least distance of the ankle of a spread leg from the middle of the bed (m), and bend of the knee
#: of a tucked one (rad).
_SPREAD, _TUCKED = 0.20, math.radians(60.0)


def kinds_of(who: int, index: int) -> tuple[str, str]:
    """Return how the left and the right leg of a person lie in posture ``index``."""
    pair = PAIRS[index % len(PAIRS)]
    return pair if "tucked" not in pair or PEOPLE[who].height > TALL else PAIRS[0]


def stays(world: LyingWorld, bed: Bed, side: str, kind: str) -> bool:
    """Return whether a leg at rest lies as its kind of start says.

    :param world: in which the person rests.
    :param bed: on what.
    :param side: ``left`` or ``right``.
    :param kind: one of those of :data:`PAIRS`.
    """
    if kind == "tucked":
        return bool(world.data.joint(f"{side}_knee").qpos[0] > _TUCKED)
    aside = abs(world.data.site(f"joint_{side}_ankle").xpos[1] - bed.centre[1])
    return kind != "spread" or bool(aside > _SPREAD)


def ankle_target(data: mujoco.MjData, side: str, bed: Bed) -> NDArray[np.float64]:
    """Return where an ankle is to be (3,), world frame, metres.

    :param data: of a person in a pose.
    :param side: ``left`` or ``right``.
    :param bed: on what the person lies.
    """
    return end_target(data, LimpLegs, side, ASIDE, _SLACK, bed.centre[2] + HEIGHT)
