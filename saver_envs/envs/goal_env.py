"""The Gymnasium adapter: one episode, goal-conditioned."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from saver_envs.envs.single_episode import SingleEpisode
from saver_envs.envs.spaces import GoalReward, action_space, observation_space, warn_if_short

DictObservation = dict[str, NDArray[np.float32]]


class SaverGoalEnv(SingleEpisode, GoalReward, gymnasium.Env[Any, Any]):
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
        self.action_space = action_space(self.episodes)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[DictObservation, dict[str, Any]]:
        """Start an episode.

        :param seed: makes this and the following episodes reproducible.
        :param options: none are known; given for the API's sake.
        :return: observation and info.
        """
        super().reset(seed=seed)
        if self.spec is not None:
            warn_if_short(self.episodes, int(self.episodes.elapsed[0]))
        self.episodes.set_generator(0, self.np_random)
        outcome = self._shown(self.episodes.reset())
        return self._observation(), outcome.info_of(0)

    def step(
        self, action: NDArray[np.floating]
    ) -> tuple[DictObservation, float, bool, bool, dict[str, Any]]:
        """Apply one action for 0.04 s.

        :param action: (action_size,), clipped to [-1, 1].
        :return: observation, reward, terminated (never), truncated, info.
        :raises ValueError: for a wrong shape or a value that is not finite; nothing has changed.
        :raises gymnasium.error.ResetNeeded: before the first reset.
        """
        outcome = self._stepped(action)
        return (
            self._observation(),
            float(outcome.reward[0]),
            False,
            bool((outcome.truncated if self.spec is None else outcome.diverged)[0]),
            outcome.info_of(0),
        )

    def _observation(self) -> DictObservation:
        return {name: rows[0] for name, rows in self.episodes.observation().as_dict().items()}

    def compute_terminated(
        self,
        achieved_goal: NDArray[np.floating],
        desired_goal: NDArray[np.floating],
        info: Any = None,
    ) -> Any:
        """Return False for each of the goals (..., goal_size): only the clock ends episodes."""
        return np.zeros(np.shape(achieved_goal)[:-1], dtype=bool)[()]

    compute_truncated = compute_terminated
