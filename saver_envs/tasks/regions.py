"""Where hands, objects and targets may be: boxes in each arm's base frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from saver_envs.control import Workspace
from saver_envs.scenes import BASE_SPACING, Arms

#: Box that set-points are clipped to (m), the base frame's y to the arm's left.
HAND_LOWER = (0.25, -0.45, 0.02)
HAND_UPPER = (0.60, 0.45, 0.40)
#: Objects and targets: depth (m) and half-width (m) of their box.
OBJECT_DEPTH = (0.30, 0.55)
OBJECT_HALF_WIDTH = 0.42
#: Beside another arm, a box ends this far outside the arm's base line (m) ...
OUTSIDE = 0.10
#: ... and this far beyond the middle line between the two arms (m).
OVERLAP = 0.12
#: Around the table the boxes are narrower, since the arms face each other (m).
RING_HALF_WIDTH = 0.25


@dataclass(frozen=True)
class Regions:
    """The boxes of all arms of a scene, one row per arm, each in the arm's base frame.

    :param workspace: where set-points are clipped to.
    :param object_lower: (arms, 2) least x and y of objects and targets, metres.
    :param object_upper: (arms, 2) greatest x and y, metres.
    :param reach: greatest horizontal distance of objects and targets from the base, metres.
    """

    workspace: Workspace
    object_lower: NDArray[np.float64]
    object_upper: NDArray[np.float64]
    reach: float


@lru_cache(maxsize=64)
def regions(arms: Arms, overlap: float = OVERLAP) -> Regions:
    """Return the boxes of a scene.

    :param arms: which arms, and how they stand.
    :param overlap: how far a box reaches beyond the middle line to a neighbour, metres.
    :return: the regions; callers share them.
    """
    n_arms, robot = arms.n, arms.robot
    half_width = np.full((n_arms, 2), OBJECT_HALF_WIDTH)  # to the right, to the left
    if n_arms > 1 and arms.bases == "row":
        towards_neighbour = BASE_SPACING / 2 + overlap
        half_width[:] = towards_neighbour
        half_width[0, 0] = half_width[-1, 1] = OUTSIDE
    elif n_arms > 1:
        half_width[:] = RING_HALF_WIDTH
    lower = np.stack([np.full(n_arms, OBJECT_DEPTH[0]), -half_width[:, 0]], axis=-1)
    upper = np.stack([np.full(n_arms, OBJECT_DEPTH[1]), half_width[:, 1]], axis=-1)
    hand_lower, hand_upper = np.tile(HAND_LOWER, (n_arms, 1)), np.tile(HAND_UPPER, (n_arms, 1))
    # A hand has room behind the outermost object, on either side.
    hand_lower[:, 1] = np.minimum(hand_lower[:, 1], lower[:, 1])
    hand_upper[:, 1] = np.maximum(hand_upper[:, 1], upper[:, 1])
    workspace = Workspace(hand_lower, hand_upper, robot.hand_reach, robot.shoulder_height)
    return Regions(workspace, lower, upper, robot.reach)
