"""A small PettingZoo environment of somebody else's, for tests of vector environments of agents."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv


class Counting(ParallelEnv):
    """Two agents that see the sums of their own actions, and are rewarded with their actions.

    :param lengths: of the agents' episodes, in steps.
    :param sizes: of their observations.
    """

    metadata = {"name": "counting"}  # noqa: RUF012
    render_mode = None

    def __init__(self, lengths: tuple[int, int] = (3, 3), sizes: tuple[int, int] = (1, 1)) -> None:
        self.possible_agents = ["left", "right"]
        self.lengths = dict(zip(self.possible_agents, lengths, strict=True))
        self.sizes = dict(zip(self.possible_agents, sizes, strict=True))
        self.seeds: list[int | None] = []

    def observation_space(self, agent: str) -> spaces.Box:
        return spaces.Box(-np.inf, np.inf, (self.sizes[agent],), np.float32)

    def action_space(self, agent: str) -> spaces.Box:
        return spaces.Box(-1.0, 1.0, (1,), np.float32)

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        self.seeds.append(seed)
        self.agents = list(self.possible_agents)
        self.clock = 0
        self.sums = {agent: np.zeros(self.sizes[agent], np.float32) for agent in self.agents}
        return dict(self.sums), {agent: {"begun": agent} for agent in self.agents}

    def step(self, actions: dict[str, Any]) -> Any:
        self.clock += 1
        self.sums = {agent: self.sums[agent] + actions[agent] for agent in self.agents}
        over = {agent: self.clock == self.lengths[agent] for agent in self.agents}
        rewards = {agent: float(actions[agent][0]) for agent in self.agents}
        never = dict.fromkeys(self.agents, False)
        infos = {agent: {"of": agent} for agent in self.agents}
        return dict(self.sums), rewards, over, never, infos
