"""Sensor noise on a vector environment of Stable-Baselines3."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnvWrapper

from saver_envs.envs.sb3_vec_env import SaverVecEnv
from saver_envs.wrappers.sensor_noise import Observation, SensorErrors, SensorNoise, episodes_of


class NoisyVecSensors(VecEnvWrapper):
    """A :class:`saver_envs.envs.sb3_vec_env.SaverVecEnv` with sensor noise.

    :param venv: the vector environment, possibly wrapped.
    :param noise: how large the errors are.
    :raises TypeError: for another environment.
    """

    def __init__(self, venv: Any, noise: SensorNoise | None = None) -> None:
        super().__init__(venv)
        self.noise = noise or SensorNoise()
        if not isinstance(venv.unwrapped, SaverVecEnv):
            raise TypeError(f"venv={venv!r}: must be a SaverVecEnv, itself or in wrappers")
        self._errors = SensorErrors.of(self.noise, episodes_of(venv))

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed episodes and errors for the next reset; episode i gets ``seed + i``."""
        seeds = self.venv.seed(seed)
        self._seed_errors(seeds)
        return seeds

    def reset(self) -> Observation:
        """Start all episodes."""
        observation: Any = self.venv.reset()
        return self._begun(observation)

    def reset_episodes(self, seeds: Sequence[int]) -> Observation:
        """Start all episodes, episode i from ``seeds[i]``."""
        observation = self.venv.unwrapped.reset_episodes(seeds)  # type: ignore[attr-defined]
        self._seed_errors(seeds)
        return self._begun(observation)

    def step_wait(
        self,
    ) -> tuple[Observation, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Apply the actions; episodes that end are reset at once, and get new errors."""
        observation, reward, done, infos = self.venv.step_wait()
        rows = np.flatnonzero(done)
        for row in rows.tolist():
            last = self._errors.seen(infos[row]["terminal_observation"], [row])
            infos[row] = {**infos[row], "terminal_observation": last}
        self._errors.begin(rows)
        return self._errors.seen(observation), reward, done, infos

    def _seed_errors(self, seeds: Sequence[int | None]) -> None:
        for row, seed in enumerate(seeds):
            self._errors.seed(row, seed)

    def _begun(self, observation: Observation) -> Observation:
        self._errors.begin(range(self.num_envs))
        return self._errors.seen(observation)
