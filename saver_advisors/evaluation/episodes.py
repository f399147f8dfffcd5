"""Play evaluation episodes: fixed seeds, deterministic actions, only the policy under test.

Episode i starts from ``seed + i``, regardless of the number of parallel environments. Two policies
therefore see the same initial states, and each episode can be reproduced alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from saver_advisors.evaluation.statistics import success_interval, worst_mean

if TYPE_CHECKING:
    from saver_envs.episodes import Episodes
    from saver_envs.tasks.contract import Task

Observation = dict[str, NDArray[Any]]
Predict = Callable[[Observation], NDArray[Any]]
"""From a batched Dict observation (n, size) to actions (n, action_size)."""
Stepped = tuple[Any, NDArray[Any], NDArray[Any], list[dict[str, Any]]]
"""Observation, rewards, dones and infos, as SB3's vector envs return them."""

GOALS: Final = ("achieved_goal", "desired_goal")
N_ENVS: Final = 16
"""Most environments that are stepped together; their number has no effect on the outcomes."""
STRICT, STRICT_ANGLE = 0.02, math.radians(4.0)
"""The stricter tolerance that ``success_rate_2cm`` is about, metres, and that of angles."""
CONSTRAINT_RATES: Final = ("constraint_met_rate", "goal_success_rate")
"""Entries of a summary that only tasks with a constraint have."""

LONGEST_EPISODE: Final = 10_000
"""Step limit of the player; every registered id truncates long before it."""


class EpisodeVecEnv(Protocol):
    """A vector env with SB3's ``step``, same-step autoreset and a seed for each episode."""

    num_envs: int

    def reset_episodes(self, seeds: Sequence[int]) -> Observation:
        """Start an episode in every environment k from ``seeds[k]``."""

    def step(self, actions: NDArray[Any]) -> Stepped:
        """Step; an info of an episode that ended has ``terminal_observation``."""


class SingleEpisodeEnv:
    """Present one Gymnasium env to :func:`play`, without autoreset.

    After the last step the env still shows the terminal state, so it can be rendered.

    :param env: a goal environment of this suite
    """

    num_envs = 1

    def __init__(self, env: Any) -> None:
        self.env = env
        #: Of the last reset.
        self.reset_infos: list[dict[str, Any]] = [{}]

    def reset_episodes(self, seeds: Sequence[int]) -> Observation:
        """Start the episode of ``seeds[0]``."""
        observation, info = self.env.reset(seed=seeds[0])
        self.reset_infos = [info]
        return self._batch(observation)

    def step(self, actions: NDArray[Any]) -> Stepped:
        """Step the env; see :class:`EpisodeVecEnv`."""
        observation, reward, terminated, truncated, info = self.env.step(actions[0])
        done = terminated or truncated
        if done:
            info = {**info, "terminal_observation": observation}
        return self._batch(observation), np.array([reward]), np.array([done]), [info]

    @staticmethod
    def _batch(observation: Observation) -> Observation:
        return {name: values[None] for name, values in observation.items()}


@dataclass(frozen=True)
class EpisodeStep:
    """One step of every environment that :func:`play` drives.

    :param number: of the step; 0 is the reset, which has no rewards, dones or infos
    :param running: (n,) environments whose episode had not ended before this step
    :param observation: after the step, (n, size) each
    :param rewards: (n,)
    :param dones: (n,)
    :param infos: one mapping per environment
    """

    number: int
    running: NDArray[np.bool_]
    observation: Observation
    rewards: NDArray[Any]
    dones: NDArray[Any]
    infos: Sequence[Mapping[str, Any]]


def play(predict: Predict, vec_env: EpisodeVecEnv, seeds: Sequence[int]) -> Iterator[EpisodeStep]:
    """Play one episode in every environment; stop when the last of them has ended.

    Episodes that an autoreset starts are stepped too, and marked as not running.

    :param predict: batched Dict observation (n, size) -> actions (n, action_size)
    :param vec_env: the environments
    :param seeds: (n,) the seed of each episode
    :return: the reset, then every step
    :raises RuntimeError: for an episode that does not end
    """
    n = vec_env.num_envs
    running = np.ones(n, bool)
    observation = vec_env.reset_episodes(seeds)
    yield EpisodeStep(0, running, observation, np.zeros(n), np.zeros(n, bool), [{}] * n)
    for number in range(1, LONGEST_EPISODE + 1):
        observation, rewards, dones, infos = vec_env.step(predict(observation))
        yield EpisodeStep(number, running, observation, rewards, dones, infos)
        running = running & ~np.asarray(dones, bool)
        if not running.any():
            return
    raise RuntimeError(
        f"an episode did not end within {LONGEST_EPISODE} steps: the environment must truncate"
    )


@dataclass(frozen=True)
class EpisodeOutcomes:
    """Outcomes of evaluation episodes, one entry per episode.

    :param env_id: id of the environment
    :param seed: of episode 0; episode i has ``seed + i``
    :param success: (episodes,) `is_success` of the last step
    :param returns: (episodes,) sum of rewards
    :param cost_sums: (episodes,) sum of each cost over the episode, by name
    :param cost_maxima: (episodes,) maximum of each cost in the episode, by name
    :param final_distances: (episodes, objects) from each object to its target at the end
    :param lengths: (episodes,) steps
    :param diverged: (episodes,) whether the simulation diverged
    :param goal_reached: (episodes,) every object at its target at the end, where the environment
        distinguishes it from success (tasks with a constraint); else None
    :param deviations: (episodes, 2) mean and maximum over the episode of the deviation of the
        constraint's value from the required one, metres; None for tasks without a constraint
    :param collision_forces: (episodes,) highest `collision_force` of the episode, N; None where the
        environment does not report it
    :param lost: (episodes,) whether an object left the table; None where the environment does not
        report it
    :param unit: of the distances, ``m`` or ``rad``
    :param world: digest of the world, see :mod:`saver_envs.digest`; None if unknown
    :param randomization: what differs between the episodes, each with its distribution
    """

    env_id: str
    seed: int
    success: NDArray[np.bool_]
    returns: NDArray[np.float64]
    cost_sums: Mapping[str, NDArray[np.float64]]
    cost_maxima: Mapping[str, NDArray[np.float64]]
    final_distances: NDArray[np.float64]
    lengths: NDArray[np.int64]
    diverged: NDArray[np.bool_]
    goal_reached: NDArray[np.bool_] | None = None
    deviations: NDArray[np.float64] | None = None
    collision_forces: NDArray[np.float64] | None = None
    lost: NDArray[np.bool_] | None = None
    unit: str = "m"
    world: str | None = None
    randomization: Mapping[str, Any] = field(default_factory=dict)

    @property
    def episodes(self) -> int:
        """Number of episodes."""
        return len(self.success)

    @property
    def success_rate(self) -> float:
        """SR: fraction of episodes that end in success."""
        return float(self.success.mean())

    @property
    def safe_success_rate(self) -> float:
        """Fraction of episodes with success and without ``cost_collision`` at any step, or without
        ``cost`` where collisions are not counted.
        """
        cost = self.cost_sums.get("cost_collision", self.cost_sums.get("cost", 0.0))
        return float((self.success & np.equal(cost, 0.0)).mean())

    @property
    def success_rate_2cm(self) -> float:
        """Fraction of episodes with success and every object within 2 cm of its target; within 4
        degrees where goals are angles.
        """
        within = self.final_distances <= (STRICT_ANGLE if self.unit == "rad" else STRICT)
        return float((self.success & within.all(axis=1)).mean())

    @property
    def cost_rates(self) -> dict[str, float]:
        """Fraction of episodes in which a cost was above 0 at any step, by name."""
        return {name: float((sums > 0).mean()) for name, sums in self.cost_sums.items()}

    @property
    def confidence_interval(self) -> tuple[float, float]:
        """95% Wilson score interval of the success rate."""
        return success_interval(int(self.success.sum()), self.episodes)

    @property
    def constraint_met_rate(self) -> float | None:
        """CMR: fraction of episodes without ``cost_distance`` at any step; None for tasks without
        that cost.
        """
        distance = self.cost_sums.get("cost_distance")
        return None if distance is None else float((distance == 0.0).mean())

    @property
    def goal_success_rate(self) -> float | None:
        """GSR: fraction of episodes that end with the goal reached, whether or not the constraint
        is met; None where the environment does not distinguish the two.
        """
        return None if self.goal_reached is None else float(self.goal_reached.mean())

    def summary(self) -> dict[str, Any]:
        """Return JSON-able means and rates, without the rates that the environment lacks."""
        values: dict[str, Any] = {
            "env": self.env_id,
            "world": self.world,
            "seed": self.seed,
            "episodes": self.episodes,
            "success_rate": self.success_rate,
            "ci95": list(self.confidence_interval),
            "safe_success_rate": self.safe_success_rate,
            "success_rate_2cm": self.success_rate_2cm,
            "return_mean": float(self.returns.mean()),
            "length_mean": float(self.lengths.mean()),
            "final_distance_mean": self.final_distances.mean(axis=0).tolist(),
            "distance_unit": self.unit,
            "diverged": int(self.diverged.sum()),
            "cost_means": {name: float(sums.mean()) for name, sums in self.cost_sums.items()},
            "cost_rates": self.cost_rates,
            "cost_cvar": {name: worst_mean(sums) for name, sums in self.cost_sums.items()},
        }
        if self.deviations is not None:
            values["deviation_mean"] = float(self.deviations[:, 0].mean())
            values["deviation_worst"] = float(self.deviations[:, 1].max())
        if self.collision_forces is not None:
            values["collision_force_mean"] = float(self.collision_forces.mean())
            values["collision_force_max"] = float(self.collision_forces.max())
        if self.lost is not None:
            values["object_lost"] = int(self.lost.sum())
        if self.randomization:
            values["randomization"] = dict(self.randomization)
        rates = {name: getattr(self, name) for name in CONSTRAINT_RATES}
        return values | {name: rate for name, rate in rates.items() if rate is not None}


def evaluate_policy(
    predict: Predict,
    env_id: str,
    *,
    episodes: int = 100,
    seed: int = 0,
    env_kwargs: Mapping[str, Any] | None = None,
    threads: int = 1,
    progress: bool = False,
    guard: Callable[[Predict, Episodes], Predict] | None = None,
) -> EpisodeOutcomes:
    """Evaluate a policy on an environment.

    :param predict: batched Dict observation (n, size) -> actions (n, action_size); deterministic
    :param env_id: a registered id such as "DualJacoPush-v0"
    :param episodes: number of episodes
    :param seed: of episode 0; episode i starts from ``seed + i``
    :param env_kwargs: keyword arguments of the environment
    :param threads: native threads of the simulation; has no effect on the outcomes
    :param progress: show a progress bar
    :param guard: makes of the policy and its episodes one that acts in its place, such as
        :class:`saver_advisors.evaluation.shield.Shield`
    :return: the outcomes
    :raises ValueError: for fewer than 1 episode or thread
    """
    if episodes < 1:
        raise ValueError(f"episodes={episodes} must be at least 1")
    # Imported here: only this function needs a simulator.
    from saver_envs.digest import world_digest
    from saver_envs.envs.sb3_vec_env import SaverVecEnv

    n_envs = min(episodes, N_ENVS)
    options = {"collision_force": True, **(env_kwargs or {})}
    vec_env = SaverVecEnv(env_id, n_envs=n_envs, seed=seed, threads=threads, **options)
    with closing(vec_env):
        task = vec_env.episodes.task
        varied = vec_env.episodes.settings.randomization.as_json()
        if guard is not None:
            predict = guard(predict, vec_env.episodes)
        outcomes = run_episodes(predict, vec_env, task, env_id, episodes, seed, progress)
    world = world_digest(env_id, env_kwargs)
    return replace(outcomes, world=world, randomization=varied)


def run_episodes(
    predict: Predict,
    vec_env: EpisodeVecEnv,
    task: Task,
    env_id: str,
    episodes: int,
    seed: int = 0,
    progress: bool = False,
) -> EpisodeOutcomes:
    """Evaluate a policy on an existing vector env, which stays open.

    :param predict: as for :func:`evaluate_policy`
    :param vec_env: the environments
    :param task: of the environments
    :param env_id: name of the environment in the outcomes
    :param episodes: number of episodes, at least 1
    :param seed: of episode 0
    :param progress: show a progress bar
    :return: the outcomes
    """
    from tqdm import tqdm

    records: list[_EpisodeRecord] = []
    with tqdm(total=episodes, unit="episode", disable=not progress) as bar:
        while len(records) < episodes:
            first = seed + len(records)
            batch = [_EpisodeRecord() for _ in range(vec_env.num_envs)]
            for step in play(predict, vec_env, range(first, first + vec_env.num_envs)):
                if step.number > 0:
                    for index in np.flatnonzero(step.running):
                        batch[index].add(task, step, int(index))
            # The last batch may contain surplus episodes.
            batch = batch[: episodes - len(records)]
            records += batch
            bar.update(len(batch))
    entries = joined(list(map(vars, records)))
    return EpisodeOutcomes(env_id=env_id, seed=seed, unit=task.goal[0].unit, **entries)


@dataclass
class _EpisodeRecord:
    """Entries of :class:`EpisodeOutcomes` for one episode."""

    success: bool = False
    returns: float = 0.0
    cost_sums: dict[str, float] = field(default_factory=dict)
    cost_maxima: dict[str, float] = field(default_factory=dict)
    final_distances: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    lengths: int = 0
    diverged: bool = False
    goal_reached: bool | None = None
    #: The sum instead of the mean until the episode ends, and the maximum.
    deviations: tuple[float, float] | None = None
    collision_forces: float | None = None
    lost: bool | None = None

    def add(self, task: Task, step: EpisodeStep, index: int) -> None:
        """Add the step of environment ``index``."""
        info, done = step.infos[index], bool(step.dones[index])
        # After an autoreset the batch holds the next episode's observation.
        goals = info.get("terminal_observation") if done else None
        achieved, desired = (goals[key] if goals else step.observation[key][index] for key in GOALS)
        self.returns += float(step.rewards[index])
        self.lengths += 1
        self.diverged |= bool(info.get("diverged", False))
        for name, value in info.items():
            if name == "cost" or name.startswith("cost_"):
                self.cost_sums[name] = self.cost_sums.get(name, 0.0) + float(value)
                self.cost_maxima[name] = max(self.cost_maxima.get(name, -np.inf), float(value))
        if (force := info.get("collision_force")) is not None:
            self.collision_forces = max(self.collision_forces or 0.0, float(force))
        if task.constraint is not None:
            deviation = float(task.deviation(achieved, desired))
            total, largest = self.deviations or (0.0, 0.0)
            total, largest = total + deviation, max(largest, deviation)
            self.deviations = (total / self.lengths if done else total), largest
        if done:
            self.success = bool(info["is_success"])
            reached = info.get("goal_reached", info.get("goal_success"))
            self.goal_reached = None if reached is None else bool(reached)
            lost = info.get("object_lost")
            self.lost = None if lost is None else bool(lost)
            ends = (np.asarray(goal, np.float64) for goal in (achieved, desired))
            self.final_distances = np.asarray(task.distances(*ends), np.float64)


def curve_point(summary: Mapping[str, Any]) -> dict[str, Any]:
    """Return the figures of an evaluation that a learning curve keeps.

    :param summary: of the outcomes
    :return: rates, forces of collisions and costs, without those that the environment lacks
    """
    rates = ("success_rate", "safe_success_rate", "success_rate_2cm", *CONSTRAINT_RATES)
    names = (*rates, "collision_force_mean", "collision_force_max")
    figures = {name: summary[name] for name in names if name in summary}
    return {**figures, **dict(sorted(summary["cost_means"].items()))}


def joined(parts: Sequence[Any], join: Callable[[Sequence[Any]], Any] = np.array) -> Any:
    """Join the entries of several outcomes.

    :param parts: of one entry: numbers or arrays, mappings of them, or None
    :param join: of numbers or arrays
    :return: the same with joined entries
    """
    if isinstance(parts[0], Mapping):
        return {name: joined([part[name] for part in parts], join) for name in parts[0]}
    return None if parts[0] is None else join(parts)
