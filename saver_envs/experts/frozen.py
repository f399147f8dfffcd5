"""The ablation: one arm serves every cube in turn while the others stay where they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saver_envs.experts.blocks import ArmView
from saver_envs.experts.skill import Skill

FloatArray = NDArray[np.floating]


@dataclass(frozen=True)
class ServesAll:
    """One free arm that brings its own cube to its target, then its neighbours' to theirs.

    :param skill: what an arm does by itself.
    :param base: (arms, 2) base positions of a row along y, metres.
    :param free: index of the arm that moves.
    :param own_last: serve the own cube last; its target may be in the air, where it must be held.
    """

    skill: Skill
    base: FloatArray
    free: int
    own_last: bool = False

    def actions(self, view: ArmView) -> FloatArray:
        """Return the arms' actions (n, arms, 3 or 4), zero for all but the free one."""
        n, arms = view.tool.shape[:2]
        order = sorted(range(arms), key=lambda arm: ((arm == self.free) == self.own_last, arm))
        left = ~self.skill.finished(view)[:, order]
        arm = np.asarray(order)[np.where(left.any(axis=1), left.argmax(axis=1), arms - 1)]
        rows, free = np.arange(n), slice(self.free, self.free + 1)
        shift = np.zeros((n, 1, 3))
        shift[:, 0, :2] = (self.base - self.base[self.free])[arm]
        served = ArmView(
            tool=view.tool[:, free],
            fingers=view.fingers[:, free],
            object=view.object[rows, arm][:, None] + shift,
            object_quaternion=view.object_quaternion[rows, arm][:, None],
            object_velocity=view.object_velocity[rows, arm][:, None],
            target=view.target[rows, arm][:, None] + shift,
        )
        action = self.skill.actions(served)
        result = np.zeros((n, arms, action.shape[-1]))
        result[:, free] = action
        return result
