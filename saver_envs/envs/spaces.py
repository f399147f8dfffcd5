"""Spaces and rewards of episodes, shared by the adapters."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from saver_envs.episodes import Episodes


def observation_space(episodes: Episodes) -> spaces.Dict:
    """Return the goal-conditioned space: ``observation``, ``achieved_goal``, ``desired_goal``."""

    def box(size: int) -> spaces.Box:
        return spaces.Box(-np.inf, np.inf, (size,), np.float32)

    return spaces.Dict(
        {
            "observation": box(episodes.observation_size),
            "achieved_goal": box(episodes.goal_size),
            "desired_goal": box(episodes.goal_size),
        }
    )


def action_space(episodes: Episodes) -> spaces.Box:
    """Return the box [-1, 1] of all arms' actions."""
    return spaces.Box(-1.0, 1.0, (episodes.action_size,), np.float32)


class GoalReward:
    """Adds the reward function that relabelling calls to an adapter with ``episodes``."""

    episodes: Episodes

    def compute_reward(
        self,
        achieved_goal: NDArray[np.floating],
        desired_goal: NDArray[np.floating],
        info: Any = None,
    ) -> NDArray[np.float32]:
        """Return the reward of goals (..., goal_size), shape (...); pure."""
        return self.episodes.task.reward(np.asarray(achieved_goal), np.asarray(desired_goal))
