"""Small environments with costs: Box and goal observations, ends and time limits, and bad ones."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecEnv

LENGTH = 8


class Walk(gymnasium.Env[Any, Any]):
    """The action is the reward; half of its positive part is the cost.

    :param goal: whether observations are those of a goal environment
    :param ends: whether an episode terminates after its steps, instead of being truncated
    :param bad: what ``info["cost"]`` holds from ``bad_from`` on; "absent" for no cost
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012

    def __init__(
        self, goal: bool = False, ends: bool = False, bad: Any = None, bad_from: int = 0
    ) -> None:
        box = spaces.Box(-5.0, 5.0, (3,), np.float32)
        point = spaces.Box(-5.0, 5.0, (2,), np.float32)
        names = {"observation": box, "achieved_goal": point, "desired_goal": point}
        self.observation_space = spaces.Dict(names) if goal else box
        self.action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.goal, self.ends, self.bad, self.bad_from = goal, ends, bad, bad_from
        self.steps = 0
        self.x = 0.0

    def _observation(self) -> Any:
        body = np.array([self.x, self.steps / LENGTH, 1.0], np.float32)
        if not self.goal:
            return body
        return {
            "observation": body,
            "achieved_goal": body[:2].copy(),
            "desired_goal": np.ones(2, np.float32),
        }

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.steps, self.x = 0, float(self.np_random.uniform(-1, 1))
        return self._observation(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        effort = float(action[0])
        self.x = float(np.clip(self.x + effort, -5, 5))
        info: dict[str, Any] = {"cost": max(effort, 0.0) / 2}
        if self.bad is not None and self.steps >= self.bad_from:
            info = {} if self.bad == "absent" else {"cost": self.bad}
        self.steps += 1
        over = self.steps >= LENGTH
        return self._observation(), effort, over and self.ends, over and not self.ends, info


def make_walk(n_envs: int = 3, seed: int = 0, **options: Any) -> VecEnv:
    """A vector of walks under SB3's monitors."""
    return make_vec_env(Walk, n_envs=n_envs, seed=seed, env_kwargs=options)


class CostOfAngle(gymnasium.Wrapper[Any, Any, Any, Any]):
    """A pole's lean as its cost."""

    def step(self, action: Any) -> Any:
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, reward, terminated, truncated, {**info, "cost": abs(observation[2])}
