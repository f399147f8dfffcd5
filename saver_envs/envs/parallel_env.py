"""The PettingZoo adapter: one agent per arm, all acting at once for a shared reward."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from saver_envs.control import checked_action
from saver_envs.envs.single_episode import SingleEpisode
from saver_envs.envs.spaces import box, goal_array
from saver_envs.episodes import Outcome
from saver_envs.validation import require

Observations = dict[str, Any]
"""Of each agent: an array, or a Dict of arrays with ``own_goals``."""
Infos = dict[str, dict[str, Any]]


class SaverParallelEnv(SingleEpisode, ParallelEnv[str, Any, NDArray[np.floating]]):
    """One episode of a registered id with an agent for every arm: ``arm_0``, ``arm_1``, ...

    An agent sees its own arm's block of the observation, what all arms share of it, its own
    desired goal, and after them what the whole team's goal holds: in the distance task the
    achieved and the required distance (m). It acts with its own arm's numbers. All agents get the
    team's reward, and all are truncated together. An agent's ``info`` has ``is_success`` of its own
    object, ``team_success``, ``goal_reached`` (every object is at its target), ``object_lost``,
    ``diverged`` and the costs, which are the team's.

    With ``own_goals`` every agent is goal-conditioned: its observation is a Dict of
    ``observation``, ``achieved_goal`` and ``desired_goal``, its reward is that of its own goal, and
    :meth:`compute_reward` relabels it.

    It can be pickled and deep-copied within an episode: the copy continues identically.

    :param env_id: a registered id.
    :param render_mode: ``human``, ``rgb_array``, ``depth_array`` or ``None``.
    :param max_cycles: ``max_episode_steps`` under PettingZoo's name, which takes precedence.
    :param width: pixels of a picture.
    :param height: pixels of a picture.
    :param camera_name: ``front``, ``three_quarter``, ``side`` or ``overhead``.
    :param inverse_kinematics: replaces damped least squares.
    :param own_goals: whether agents observe and are rewarded for goals of their own.
    :param options: of :class:`saver_envs.registration.ControlOptions`, and the task's fields.
    :raises ValueError: for an unknown id, render mode or camera, or an option out of range.
    :raises TypeError: for an unknown option.
    """

    def __init__(
        self,
        env_id: str,
        render_mode: str | None = None,
        max_cycles: int | None = None,
        own_goals: bool = False,
        **options: Any,
    ) -> None:
        self.own_goals = own_goals
        if max_cycles is not None:
            options["max_episode_steps"] = max_cycles
        super().__init__(env_id, render_mode, **options)
        self.metadata = {**self.metadata, "is_parallelizable": True, "name": env_id}
        task = self.episodes.task
        self.possible_agents = [f"arm_{index}" for index in range(task.n_arms)]
        self.agents: list[str] = []
        seen, goal = task.observation_layout, task.goal_layout
        parts = [self.episodes.limits_of(one) for one in (seen, goal, goal)]
        action_size = self.episodes.action_size_per_arm
        self.observation_spaces: dict[str, spaces.Space[Any]] = {
            agent: (
                spaces.Dict({name: box(part) for name, part in limits.items()})
                if isinstance(limits, dict)
                else box(limits)
            )
            for agent, limits in self._of_agents(*parts).items()
        }
        self.action_spaces = {
            agent: spaces.Box(-1.0, 1.0, (action_size,), np.float32)
            for agent in self.possible_agents
        }
        self.state_space = box(np.concatenate(parts))
        self._generator: np.random.Generator | None = None

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Return an agent's observation space, the same object at every call."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Box:
        """Return an agent's action space, the same object at every call."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, Infos]:
        """Start an episode.

        :param seed: makes this and the following episodes reproducible.
        :param options: none are known; given for the API's sake.
        :return: every agent's observation and info.
        """
        if seed is not None or self._generator is None:
            self._generator = seeding.np_random(seed)[0]
            self.episodes.set_generator(0, self._generator)
        outcome = self._shown(self.episodes.reset())
        self.agents = list(self.possible_agents)
        return self._observations(), self._infos(outcome)

    def step(
        self, actions: dict[str, NDArray[np.floating]]
    ) -> tuple[Observations, dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """Apply every agent's action for 0.04 s.

        :param actions: agent -> (action_size,), clipped to [-1, 1]; one for every living agent.
        :return: observations, rewards, terminated (never), truncated and infos of the agents that
            acted; all empty once the episode is over.
        :raises ValueError: for a missing or unknown agent, a wrong shape or a value that is not
            finite; nothing has changed.
        :raises gymnasium.error.ResetNeeded: before the first reset.
        """
        self.episodes.require_begun()
        agents = self.agents
        if not agents and not actions:
            return {}, {}, {}, {}, {}
        joined = self._joined(actions)
        outcome = self._shown(self.episodes.step(joined[None]))
        truncated = bool(outcome.truncated[0])
        if truncated:
            self.agents = []
        observations = self._observations()
        rewards = dict.fromkeys(agents, float(outcome.reward[0]))
        if self.own_goals:
            rewards = {
                agent: float(self.compute_reward(seen["achieved_goal"], seen["desired_goal"]))
                for agent, seen in observations.items()
            }
        over = dict.fromkeys(agents, truncated)
        return observations, rewards, dict.fromkeys(agents, False), over, self._infos(outcome)

    def compute_reward(
        self,
        achieved_goal: NDArray[np.floating],
        desired_goal: NDArray[np.floating],
        info: Any = None,
    ) -> NDArray[np.float32]:
        """Return the reward of an agent's goals (..., size of its goal), shape (...); pure.

        It is the team's reward where the other agents' objects are at their targets.

        :raises ValueError: without ``own_goals``, for goals of another size, or that are not real
            numbers.
        """
        valid = "True for rewards of an agent's own goal: the team's depends on goals of all agents"
        require("own_goals", self.own_goals, self.own_goals, valid)
        achieved = self._team_goal("achieved_goal", achieved_goal)
        return self.episodes.task.reward(achieved, self._team_goal("desired_goal", desired_goal))

    def _team_goal(self, name: str, goals: NDArray[np.floating]) -> NDArray[Any]:
        """Return a team's goals (..., goal size) with an agent's for the first arm, else 0."""
        layout = self.episodes.task.goal_layout
        own = goal_array(name, goals, layout.block + layout.shared)
        team = np.zeros((*own.shape[:-1], layout.size), own.dtype)
        layout.blocks(team)[..., 0, :] = own[..., : layout.block]
        layout.tail(team)[...] = own[..., layout.block :]
        return team

    def _joined(self, actions: dict[str, NDArray[np.floating]]) -> NDArray[np.float64]:
        """Return the agents' actions one after the other, (action_size of all arms,)."""
        if set(actions) != set(self.agents):
            raise ValueError(
                f"actions for {sorted(actions)}: one is needed for each of {self.agents}"
            )
        shape = (self.episodes.action_size_per_arm,)
        return np.concatenate(
            [checked_action(actions[agent], shape, f"{agent}'s action") for agent in self.agents]
        )

    def _observations(self) -> Observations:
        return self._of_agents(*self._observation().values())

    def _of_agents(
        self, observation: NDArray[Any], achieved: NDArray[Any], desired: NDArray[Any]
    ) -> Observations:
        """Return what each agent sees of an observation and goals, or of their limits."""
        layout, goal = self.episodes.task.observation_layout, self.episodes.task.goal_layout
        if self.own_goals:
            return {
                agent: {
                    "observation": layout.of_agent(observation, arm),
                    "achieved_goal": goal.of_agent(achieved, arm),
                    "desired_goal": goal.of_agent(desired, arm),
                }
                for arm, agent in enumerate(self.possible_agents)
            }
        team = (goal.tail(achieved), goal.tail(desired))
        return {
            agent: np.concatenate(
                [layout.of_agent(observation, arm), goal.blocks(desired)[arm], *team]
            )
            for arm, agent in enumerate(self.possible_agents)
        }

    def _infos(self, outcome: Outcome) -> Infos:
        seen, task = self.episodes.observation(), self.episodes.task
        distances = task.distances(seen.achieved_goal[0], seen.desired_goal[0])
        team = outcome.info_of(0)
        team["team_success"] = team.pop("is_success")
        return {
            agent: {"is_success": bool(distances[arm] <= task.success_threshold), **team}
            for arm, agent in enumerate(self.possible_agents)
        }

    def state(self) -> NDArray[np.float32]:
        """Return what all agents together see: observation, achieved goal and desired goal."""
        return np.concatenate(list(self._observation().values()))


def parallel_env(env_id: str, **kwargs: Any) -> SaverParallelEnv:
    """Build a :class:`SaverParallelEnv`; the entry point in PettingZoo's registry.

    :param env_id: a registered id.
    :param kwargs: the class's other arguments.
    """
    return SaverParallelEnv(env_id, **kwargs)
