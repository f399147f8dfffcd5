"""Spaces and rewards of episodes, shared by the adapters."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from saver_envs.episodes import Episodes
from saver_envs.validation import real_array, require


def episodes_of(env: Any) -> Episodes:
    """Return the episodes of an environment of this package, possibly wrapped.

    :param env: single or a vector, of Gymnasium or of Stable-Baselines3.
    :raises TypeError: for another environment.
    """
    episodes = getattr(env.unwrapped, "episodes", None)
    if not isinstance(episodes, Episodes):
        raise TypeError(f"env={env!r}: must be an environment of saver_envs")
    return episodes


def observation_space(episodes: Episodes) -> spaces.Dict:
    """Return the goal-conditioned space: ``observation``, ``achieved_goal``, ``desired_goal``."""

    task = episodes.task
    return spaces.Dict(
        {
            "observation": box(episodes.limits_of(task.observation_layout)),
            "achieved_goal": box(episodes.limits_of(task.goal_layout)),
            "desired_goal": box(episodes.limits_of(task.goal_layout)),
        }
    )


def box(limits: NDArray[np.floating]) -> spaces.Box:
    """Return the box of float32 within ``limits`` (size,) around 0."""
    limits = limits.astype(np.float32)
    return spaces.Box(-limits, limits, dtype=np.float32)


def action_space(episodes: Episodes) -> spaces.Box:
    """Return the box [-1, 1] of all arms' actions."""
    return spaces.Box(-1.0, 1.0, (episodes.action_size,), np.float32)


def warn_if_short(episodes: Episodes, steps: int) -> None:
    """Warn of slow episodes that end after the actions of fast ones.

    :param episodes: of the environment.
    :param steps: number of actions after which they end.
    """
    task, settings = episodes.task, episodes.settings
    speeds = settings.randomization.distribution_of("max_speed")
    cause = "arms within the makers' limits" if settings.limit_joint_speed else ""
    if speeds is not None and speeds.ends[0] < settings.max_speed:
        cause = f"arms with a top speed from {speeds.ends[0]:g} m/s"
    if cause and steps == task.horizon < task.rated_horizon:
        gymnasium.logger.warn(
            f"episodes end after {steps} actions, as registered, but {cause} need more: pass "
            f"max_episode_steps={task.rated_horizon} as well"
        )


class GoalReward:
    """Adds the reward function that relabelling calls to an adapter with ``episodes``."""

    episodes: Episodes

    def compute_reward(
        self,
        achieved_goal: NDArray[np.floating],
        desired_goal: NDArray[np.floating],
        info: Any = None,
    ) -> NDArray[np.float32]:
        """Return the reward of goals (..., goal_size), shape (...); pure.

        :raises ValueError: for goals of another size, or that are not real numbers.
        """
        size = self.episodes.goal_size
        achieved = goal_array("achieved_goal", achieved_goal, size)
        return self.episodes.task.reward(achieved, goal_array("desired_goal", desired_goal, size))


def goal_array(name: str, goals: NDArray[np.floating], size: int) -> NDArray[Any]:
    """Return goals (..., size) as an array of real numbers.

    :param name: what the messages call them.
    :param goals: to be checked.
    :param size: that each must have.
    :raises ValueError: for goals of another size, or that are not real numbers.
    """
    checked = real_array(name, goals)
    require(f"{name}.shape", checked.shape, checked.shape[-1:] == (size,), f"(..., {size})")
    return checked
