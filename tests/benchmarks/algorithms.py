"""Algorithms of a stranger's, as small as the protocol allows."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch


class Drifter:
    """Learns nothing; remembers what it was given and how it was called."""

    made: list[Drifter] = []  # noqa: RUF012  (tests look at the last one)

    def __init__(self, env: Any, *, seed: int, speed: float = 0.5, greedy: bool = False) -> None:
        if speed < 0:
            raise ValueError(f"speed={speed} must not be negative")
        self.env, self.seed, self.speed, self.greedy = env, seed, speed, greedy
        self.starts: list[np.ndarray] = []
        self.steps = 0
        self.made.append(self)

    def learn(self, steps: int) -> None:
        observation, _ = self.env.reset()
        self.starts.append(observation["observation"])
        while self.greedy or self.steps < steps:
            noise = np.random.standard_normal(1)  # noqa: NPY002  (as strangers do)
            self.noise = float(noise[0])
            observation, _, _, truncated, _ = self.env.step(self.predict(observation))
            self.steps += self.env.num_envs
            if truncated.all() and not self.greedy:
                observation, _ = self.env.reset()

    def predict(self, observation: dict[str, np.ndarray]) -> np.ndarray:
        np.random.standard_normal(3)  # noqa: NPY002  (nobody may notice)
        gap = observation["desired_goal"] - observation["achieved_goal"]
        return self.speed * np.sign(gap)


class Elsewhere(Drifter):
    """Has torch's methods, but none of its weights there, as SBX's policies."""

    def state_dict(self) -> dict[str, torch.Tensor]:
        return {}

    def load_state_dict(self, state: dict[str, torch.Tensor]) -> None:
        raise AssertionError("there is nothing to load")


class Counter(torch.nn.Module):
    """Its policy is one number, which grows with every step; a checkpoint brings it back."""

    last: Counter

    def __init__(self, env: Any, *, seed: int) -> None:
        super().__init__()
        self.env = env
        self.register_buffer("steps", torch.zeros(1))
        self.steps: torch.Tensor
        Counter.last = self

    def learn(self, steps: int) -> None:
        self.env.reset(seed=5)
        while True:
            self.env.step(np.zeros((self.env.num_envs, 3)))
            self.steps += self.env.num_envs

    def predict(self, observation: dict[str, np.ndarray]) -> np.ndarray:
        return np.zeros((len(observation["observation"]), 3))


class Mute:
    """Cannot act."""

    def __init__(self, env: Any, *, seed: int) -> None:
        pass

    def learn(self, steps: int) -> None:
        pass
