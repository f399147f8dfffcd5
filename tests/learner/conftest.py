"""A small goal environment with the interface of the real ones."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
import pytest
import torch as th
from gymnasium import spaces
from stable_baselines3.common.vec_env import DummyVecEnv

HORIZON = 10


def before_resets(after: Any, done: npt.NDArray[Any], infos: list[dict[str, Any]]) -> Any:
    """The observations after a step, with the last ones of the episodes that ended."""
    following = {key: value.copy() for key, value in after.items()}
    for index in np.flatnonzero(done):
        for key, value in infos[index]["terminal_observation"].items():
            following[key][index] = value
    return following


class PointReach(gymnasium.Env[Any, Any]):
    """A point moves in a plane to a goal. The action box is asymmetric on purpose.

    :param horizon: steps of an episode
    :param cut_short: every third episode ends after 4 steps, as a diverged simulation would
    """

    def __init__(self, horizon: int = HORIZON, cut_short: bool = False) -> None:
        box = spaces.Box(-10.0, 10.0, (2,), np.float32)
        self.observation_space = spaces.Dict(
            {
                "observation": spaces.Box(-10.0, 10.0, (3,), np.float32),
                "achieved_goal": box,
                "desired_goal": box,
            }
        )
        self.action_space = spaces.Box(
            np.array([-2.0, -0.5], np.float32), np.array([4.0, 0.5], np.float32)
        )
        self.horizon = horizon
        self.cut_short = cut_short
        self.episodes = 0
        self.executed: list[npt.NDArray[Any]] = []

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, npt.NDArray[Any]], dict[str, Any]]:
        super().reset(seed=seed)
        self.position = np.zeros(2)
        self.goal = self.np_random.uniform(-0.5, 0.5, 2)
        self.clock = 0
        self.episodes += 1
        return self._observe(), {}

    def step(
        self, action: npt.NDArray[Any]
    ) -> tuple[dict[str, npt.NDArray[Any]], float, bool, bool, dict[str, Any]]:
        self.executed.append(np.array(action))
        self.position = np.clip(self.position + 0.1 * np.asarray(action), -10, 10)
        self.clock += 1
        horizon = 4 if self.cut_short and self.episodes % 3 == 0 else self.horizon
        observation = self._observe()
        reward = float(
            self.compute_reward(observation["achieved_goal"], observation["desired_goal"], {})
        )
        info = {"is_success": reward == 0.0, "cost": float(self.clock % 2)}
        return observation, reward, False, self.clock >= horizon, info

    def compute_reward(self, achieved: Any, desired: Any, info: Any) -> npt.NDArray[Any]:
        distance = np.linalg.norm(np.asarray(achieved) - np.asarray(desired), axis=-1)
        return np.asarray(-(distance > 0.15).astype(np.float32))

    def _observe(self) -> dict[str, npt.NDArray[Any]]:
        return {
            "observation": np.append(self.position, self.clock).astype(np.float32),
            "achieved_goal": self.position.astype(np.float32),
            "desired_goal": self.goal.astype(np.float32),
        }


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    th.set_num_threads(1)


@pytest.fixture
def make_env() -> Any:
    """A function (n_envs, **arguments of PointReach) -> vector env."""

    def make(n_envs: int = 4, **arguments: Any) -> DummyVecEnv:
        return DummyVecEnv([lambda: PointReach(**arguments) for _ in range(n_envs)])

    return make
