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
    ("crossed", "under"),
    ("under", "crossed"),
)
#: Distance of an ankle's target from the person's middle line, and its height above the bed (m).
ASIDE, HEIGHT = 0.10, 0.06
#: Bend of the knee with which the ankle is at its target (rad).
_SLACK: Final = math.radians(5.0)
#: Least distance of the ankle of a spread leg from the middle of the bed (m); bend of the knee of a
#: crossed one (rad): more of it presses the hip against the end of its range.
_SPREAD, _CROSSED = 0.20, (math.radians(22.0), math.radians(50.0))


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
    if kind == "crossed":
        least, most = _CROSSED
        return bool(least < world.data.joint(f"{side}_knee").qpos[0] < most)
    aside = abs(world.data.site(f"joint_{side}_ankle").xpos[1] - bed.centre[1])
    return kind != "spread" or bool(aside > _SPREAD)


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
    least, most = (f"{math.degrees(bend):.0f}" for bend in _CROSSED)
    return [
        f"Both legs are spread, the ankle at least {100 * _SPREAD:g} cm from the middle; or one is, "
        "and the other straight; or one is crossed over the other, the ankle on the other shank or "
        f"beyond it, the knee fallen outwards and bent by {least} to {most} degrees. All pairs are "
        "alike often.",
        f"An ankle's target is {100 * ASIDE:g} cm from the person's middle line, {100 * HEIGHT:g} cm "
        "above the bed, as far down as the leg reaches with the knee bent by "
        f"{math.degrees(_SLACK):.0f} degrees.",
        "On a slide sheet a limp leg with a more bent knee straightens by itself unless the other "
        "leg lies on its foot, and there its own weight presses the hip against the end of its "
        "range with up to 38 N m, where 20 N m are the limit: such starts are left out.",
    ]
