"""The Gymnasium adapter: one episode, goal-conditioned."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from saver_envs.envs.single_episode import GymnasiumEpisode
from saver_envs.envs.spaces import GoalReward, observation_space


class SaverGoalEnv(GoalReward, GymnasiumEpisode):
    """One episode of a registered id behind the goal API.

    An environment that ``gymnasium.make`` built leaves the horizon to Gymnasium's ``TimeLimit``, as
    any other does; one that was built by its class ends its episodes itself. It can be
    pickled and deep-copied within an episode: the copy continues identically.

    :param env_id: a registered id; ``gymnasium.make`` fills it in.
    :param render_mode: ``human``, ``rgb_array``, ``depth_array`` or ``None``.
    :param width: pixels of a picture.
    :param height: pixels of a picture.
    :param camera_name: ``front``, ``three_quarter``, ``side`` or ``overhead``.
    :param inverse_kinematics: replaces damped least squares.
    :param options: of :class:`saver_envs.registration.ControlOptions`, and the task's fields.
    :raises ValueError: for an unknown id, render mode or camera, or an option out of range.
    :raises TypeError: for an unknown option.
    """

    def __init__(self, env_id: str, render_mode: str | None = None, **options: Any) -> None:
        super().__init__(env_id, render_mode, **options)
        self.observation_space = observation_space(self.episodes)

    def compute_terminated(
        self,
        achieved_goal: NDArray[np.floating],
        desired_goal: NDArray[np.floating],
        info: Any = None,
    ) -> Any:
        """Return False for each of the goals (..., goal_size): only the clock ends episodes."""
        return np.zeros(np.shape(achieved_goal)[:-1], dtype=bool)[()]

    compute_truncated = compute_terminated
