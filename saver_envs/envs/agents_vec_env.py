"""PettingZoo environments as one Stable-Baselines3 vector environment whose rows are agents."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pettingzoo import ParallelEnv
from stable_baselines3.common.vec_env import VecEnv

from saver_envs.validation import require

Stepped = tuple[Any, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]
"""Observations, rewards, dones and infos of all rows."""


class AgentsVecEnv(VecEnv):
    """m PettingZoo environments with n agents each as m * n environments of one agent.

    Row ``i * n + k`` is agent k of environment i. A model that learns in it shares its parameters
    between all agents. Environment i is seeded with ``seed + i``, and reset in the step that ends
    it, with the agents' last observations in ``info["terminal_observation"]``.

    :param env_fns: (m,) functions that each build an environment of PettingZoo's parallel API.
    :param seed: of environment 0; ``None`` draws one.
    :raises ValueError: for agents whose spaces differ, or no environment.
    """

    _actions: NDArray[np.floating]

    def __init__(
        self, env_fns: Sequence[Callable[[], ParallelEnv[str, Any, Any]]], seed: int | None = None
    ) -> None:
        require("env_fns", env_fns, len(env_fns) > 0, "at least one function")
        self.envs = [build() for build in env_fns]
        self.agents: list[str] = list(self.envs[0].possible_agents)
        space, action_space = _spaces(self.envs[0], self.agents[0])
        for index, env in enumerate(self.envs):
            same = list(env.possible_agents) == self.agents
            require(f"agents of environment {index}", env.possible_agents, same, f"{self.agents}")
            for agent in self.agents:
                found = _spaces(env, agent)
                like = f"those of {self.agents[0]}, {(space, action_space)}"
                require(f"spaces of {agent}", found, found == (space, action_space), like)
        super().__init__(len(self.envs) * len(self.agents), space, action_space)
        self._seen: list[Any] = []
        if seed is not None:
            self.seed(seed)

    def rows_of(self, agent: str) -> slice:
        """Return the rows of an agent, one for each environment.

        :raises ValueError: for an unknown agent.
        """
        require("agent", agent, agent in self.agents, f"one of {self.agents}")
        return slice(self.agents.index(agent), None, len(self.agents))

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Seed environment i with ``seed + i`` at the next reset; ``None`` draws a seed.

        :return: the seeds of all rows; those of an environment's agents are equal.
        """
        first = int(np.random.SeedSequence().generate_state(1)[0]) if seed is None else seed
        self._seeds = [first + row // len(self.agents) for row in range(self.num_envs)]
        return list(self._seeds)

    def reset(self) -> Any:
        """Start an episode in every environment and return the observations of all rows."""
        n = len(self.agents)
        self._seen = []
        for index, env in enumerate(self.envs):
            row = index * n
            seen, infos = env.reset(seed=self._seeds[row], options=self._options[row] or None)
            self._begin(index, infos)
            self._seen += [seen[agent] for agent in self.agents]
        self._reset_seeds()
        self._reset_options()
        return self._observation()

    def step_async(self, actions: NDArray[np.floating]) -> None:
        """Keep the actions (rows, action_size) for :meth:`step_wait`."""
        self._actions = actions

    def step_wait(self) -> Stepped:
        """Apply the actions; environments that end are reset at once.

        :raises ValueError: if an agent ends before the others of its environment.
        """
        rewards, dones = np.zeros(self.num_envs, np.float32), np.zeros(self.num_envs, bool)
        infos: list[dict[str, Any]] = []
        for index, env in enumerate(self.envs):
            rows = range(index * len(self.agents), (index + 1) * len(self.agents))
            actions = dict(zip(self.agents, self._actions[rows.start : rows.stop], strict=True))
            seen, reward, terminated, truncated, own = env.step(actions)
            for row, agent in zip(rows, self.agents, strict=True):
                rewards[row] = reward[agent]
                dones[row] = terminated[agent] or truncated[agent]
                limited = truncated[agent] and not terminated[agent]
                infos.append({**own[agent], "TimeLimit.truncated": limited})
                if dones[row]:
                    infos[row]["terminal_observation"] = seen[agent]
            ended = dones[rows.start : rows.stop]
            if ended.any():
                valid = "those of all agents together, or of none"
                require(f"ended episodes of environment {index}", ended, bool(ended.all()), valid)
                seen, begun = env.reset()
                self._begin(index, begun)
            self._seen[rows.start : rows.stop] = [seen[agent] for agent in self.agents]
        return self._observation(), rewards, dones, infos

    def _begin(self, index: int, infos: dict[str, dict[str, Any]]) -> None:
        """Keep the infos of a reset."""
        start = index * len(self.agents)
        self.reset_infos[start : start + len(self.agents)] = [infos[one] for one in self.agents]

    def _observation(self) -> Any:
        """Return the observations of all rows, each entry (rows, ...)."""
        if isinstance(self._seen[0], dict):
            return {name: np.stack([one[name] for one in self._seen]) for name in self._seen[0]}
        return np.stack(self._seen)

    def _env_of(self, row: int) -> Any:
        return self.envs[row // len(self.agents)]

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of the environments of the rows asked for."""
        return [getattr(self._env_of(row), attr_name) for row in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of the environments of the rows asked for."""
        for row in self._get_indices(indices):
            setattr(self._env_of(row), attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of the environments, once for each row asked for."""
        methods = self.get_attr(method_name, indices)
        return [method(*method_args, **method_kwargs) for method in methods]

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Any = None) -> list[bool]:
        """Return False for every row: an agent is no environment that could be wrapped."""
        return [False] * len(list(self._get_indices(indices)))

    def get_images(self) -> list[NDArray[np.uint8] | None]:
        """Return a picture of every environment."""
        return [env.render() for env in self.envs]

    def close(self) -> None:
        """Close the environments."""
        for env in self.envs:
            env.close()


def _spaces(env: ParallelEnv[str, Any, Any], agent: str) -> tuple[Any, Any]:
    return env.observation_space(agent), env.action_space(agent)
