"""How the arms of a person lie before they are straightened, and where their wrists are to be."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from saver_envs.people.bed import Bed
from saver_envs.people.limp_limbs import LimpArms
from saver_envs.people.lying import LyingWorld
from saver_envs.tasks.straighten import end_target

#: How arms lie at the start, kinds of :data:`saver_envs.people.lying_starts.ARM_STARTS`.
KINDS: Final = ("chest", "bent", "abducted", "overhanging")
#: Number of pairs of kinds, of the left and the right arm.
PAIRS: Final = len(KINDS) ** 2
#: Distance of a wrist's target from the person's middle line (m).
ASIDE: Final = 0.25
#: Radius of a forearm that is not known (m).
FOREARM: Final = 0.04
#: Bend of the elbow with which the wrist is at its target (rad).
_SLACK: Final = math.radians(15.0)
#: Least height above the bed of a wrist on the chest (m), bend of a bent elbow (rad), and distance
#: of the wrist of an abducted arm from the middle line (m).
_ON_CHEST, _BENT, _ABDUCTED = 0.15, math.radians(35.0), 0.34


def kinds_of(index: int) -> tuple[str, str]:
    """Return how the left and the right arm lie in posture ``index``."""
    left, right = divmod(index % PAIRS, len(KINDS))
    return KINDS[left], KINDS[right]


def stays(world: LyingWorld, bed: Bed, side: str, kind: str) -> bool:
    """Return whether an arm at rest lies as its kind of start says.

    :param world: in which the person rests.
    :param bed: on what.
    :param side: ``left`` or ``right``.
    :param kind: one of :data:`KINDS`.
    """
    wrist = np.abs(world.data.site(f"joint_{side}_wrist").xpos - bed.centre)
    if kind == "chest":
        return bool(wrist[2] > _ON_CHEST)
    if kind == "bent":
        return bool(world.data.joint(f"{side}_elbow").qpos[0] > _BENT)
    if kind == "abducted":
        return bool(wrist[1] > _ABDUCTED)
    hand = world.model.geom(f"{side}_hand_0").id
    along = world.data.geom_xmat[hand].reshape(3, 3)[1, 2] * world.model.geom_size[hand, 1]
    middle = abs(world.data.geom_xpos[hand, 1] - bed.centre[1])
    return bool(middle + abs(along) > bed.width / 2)


def wrist_target(
    joints: Mapping[str, NDArray[np.float64]], side: str, bed: Bed, radius: float = FOREARM
) -> NDArray[np.float64]:
    """Return where a wrist is to be (3,), world frame, metres.

    It lies on the bed beside the hip, as far down as a nearly straight arm reaches.

    :param joints: of arms and hips -> (3,) where they are, world frame, metres.
    :param side: ``left`` or ``right``.
    :param bed: on what the person lies.
    :param radius: of the forearm, metres.
    """
    height = bed.centre[2] + radius
    return end_target(joints, LimpArms, side, ASIDE, _SLACK, height)


def start_text() -> list[str]:
    """Return what these starts have, a sentence each."""
    lying = {
        "chest": "with the forearm on the chest or the belly, the elbow on the bed",
        "bent": f"at the side, the elbow bent by at least {math.degrees(_BENT):.0f} degrees",
        "abducted": "on the bed, abducted by 25 to 60 degrees",
        "overhanging": "abducted further, the hand beyond the bed's edge",
    }
    return [
        "Each arm lies in one of four ways, all pairs alike often: "
        + "; ".join(lying[kind] for kind in KINDS)
        + ".",
        f"A wrist's target is on the bed, {100 * ASIDE:g} cm from the person's middle line, as far "
        f"down as the arm reaches with the elbow bent by {math.degrees(_SLACK):.0f} degrees: "
        "some 7 cm below the hip joint.",
        "The tallest of our people, whose hanging hand would catch at the edge of the bed, lies "
        "there only in worlds that vary.",
    ]
