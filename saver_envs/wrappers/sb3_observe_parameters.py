"""Adds what was drawn for an episode to its observation, for Stable-Baselines3."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper

from saver_envs.envs.spaces import episodes_of
from saver_envs.wrappers.observe_parameters import KEY, scaled_parameters, with_parameters


class VecObserveParameters(VecEnvWrapper):
    """Does for a batch what ``saver_envs.wrappers.observe_parameters.ObserveParameters`` does.

    :param venv: a :class:`saver_envs.envs.sb3_vec_env.SaverVecEnv` with ``randomization``, possibly
        wrapped.
    :raises TypeError: for another environment.
    :raises ValueError: for one whose worlds do not vary.
    """

    def __init__(self, venv: VecEnv) -> None:
        episodes = episodes_of(venv)
        super().__init__(venv, with_parameters(venv.observation_space, episodes))

    def reset(self) -> dict[str, NDArray[Any]]:
        """Start all episodes."""
        return self._extended(self.venv.reset())

    def reset_episodes(self, seeds: Sequence[int]) -> dict[str, NDArray[Any]]:
        """Start all episodes, episode i from ``seeds[i]``."""
        return self._extended(self.venv.unwrapped.reset_episodes(seeds))  # type: ignore[attr-defined]

    def step_wait(
        self,
    ) -> tuple[dict[str, NDArray[Any]], NDArray[np.float32], NDArray[np.bool_], list[Any]]:
        """Apply the actions; episodes that end are reset at once."""
        before = scaled_parameters(episodes_of(self.venv))
        observation, reward, done, infos = self.venv.step_wait()
        for row in np.flatnonzero(done).tolist():
            last = {**infos[row]["terminal_observation"], KEY: before[row]}
            infos[row] = {**infos[row], "terminal_observation": last}
        return self._extended(observation), reward, done, infos

    def _extended(self, observation: Any) -> dict[str, NDArray[Any]]:
        return {**observation, KEY: scaled_parameters(episodes_of(self.venv))}
