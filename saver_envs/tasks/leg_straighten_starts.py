"""How the legs of a person lie before they are straightened, and where their ankles are to be."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from saver_envs.people.bed import Bed
from saver_envs.people.limp_limbs import LimpLegs
from saver_envs.people.lying import LyingWorld
from saver_envs.tasks.straighten import end_target

#: How the left and the right leg lie at the start, kinds of
#: :data:`saver_envs.people.lying_starts.LEG_STARTS`.
PAIRS: Final = (
    ("spread", "spread"),
    ("spread", "straight"),
    ("straight", "spread"),
    ("spread", "adducted"),
    ("adducted", "spread"),
)
#: Distance of an ankle's target from the person's middle line, and its height above the bed (m).
ASIDE, HEIGHT = 0.10, 0.06
#: Bend of the knee with which the ankle is at its target (rad).
_SLACK: Final = math.radians(5.0)
#: How far an ankle is from the middle of the bed, at its own side, at least where the leg is spread
#: and at most where it is adducted (m).
_SPREAD, _ADDUCTED = 0.20, 0.03


def kinds_of(index: int) -> tuple[str, str]:
    """Return how the left and the right leg lie in posture ``index``."""
    return PAIRS[index % len(PAIRS)]


def stays(world: LyingWorld, bed: Bed, side: str, kind: str) -> bool:
    """Return whether a leg at rest lies as its kind of start says.

    :param world: in which the person rests.
    :param bed: on what.
    :param side: ``left`` or ``right``.
    :param kind: one of those of :data:`PAIRS`.
    """
    inner, outer = {"spread": (_SPREAD, math.inf), "adducted": (-math.inf, _ADDUCTED)}.get(
        kind, (-math.inf, math.inf)
    )
    hip, ankle = (world.data.site(f"joint_{side}_{name}").xpos[1] for name in ("hip", "ankle"))
    aside = (ankle - bed.centre[1]) * math.copysign(1.0, hip - bed.centre[1])
    return bool(inner < aside < outer)


def ankle_target(
    joints: Mapping[str, NDArray[np.float64]], side: str, bed: Bed
) -> NDArray[np.float64]:
    """Return where an ankle is to be (3,), world frame, metres.

    :param joints: of legs and hips -> (3,) where they are, world frame, metres.
    :param side: ``left`` or ``right``.
    :param bed: on what the person lies.
    """
    return end_target(joints, LimpLegs, side, ASIDE, _SLACK, bed.centre[2] + HEIGHT)


def start_text() -> list[str]:
    """Return what these starts have, a sentence each."""
    return [
        f"Both legs are spread, their ankles at least {100 * _SPREAD:g} cm from the middle of the "
        "bed; or one is, and the other is straight, or adducted to the middle or beyond. All pairs "
        "are alike often.",
        f"An ankle's target is {100 * ASIDE:g} cm from the person's middle line, as far down as "
        f"the leg reaches with the knee bent by {math.degrees(_SLACK):.0f} degrees, "
        f"{100 * HEIGHT:g} cm above the bed.",
        "Knees are straight at the start, and are to stay so. A limp bent leg straightens by "
        "itself on a slide sheet, unless it lies under the other leg or over it. Under it, its own "
        "weight presses the hip against the end of its range beyond the limit; pushed off it, it "
        "falls, and hip and knee meet more than their limits. Bent legs are therefore left out.",
    ]
