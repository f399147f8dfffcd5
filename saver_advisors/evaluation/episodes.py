"""Evaluation episodes: fixed seeds, deterministic actions, nothing but the policy under test
acting.

Episode i starts from `seed + i`, whatever the number of environments that run side by side, so two
policies meet the same starts and a figure can be reproduced one episode at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

Observation = dict[str, NDArray[Any]]
Predict = Callable[[Observation], NDArray[Any]]
"""From a batched Dict observation (n, size) to actions (n, action_size)."""
FrameCallback = Callable[["EpisodeVecEnv", int, int], None]
"""Called before each step with the vector env, the index of the episode in its environment 0, and
the step.
"""

POINT_SIZE: Final = 3
"""Numbers of one object's position in a goal; entries beyond whole points (a distance) are no
position.
"""
GOALS: Final = ("achieved_goal", "desired_goal")
DEFAULT_N_ENVS: Final = 16
CONSTRAINT_RATES: Final = ("constraint_met_rate", "goal_success_rate")
"""What a summary tells of a task with a constraint beside its success rate."""

LONGEST_EPISODE: Final = 10_000
"""Steps after which an episode counts as never ending: every id truncates at its horizon, long
before this.
"""


class EpisodeVecEnv(Protocol):
    """What is needed of the vector env: SB3's stepping, with same-step autoreset, and seeds for
    single episodes.
    """

    num_envs: int

    def reset_episodes(self, seeds: Sequence[int]) -> Observation:
        """Start an episode in every environment k from seeds[k]."""

    def step(
        self, actions: NDArray[Any]
    ) -> tuple[Any, NDArray[Any], NDArray[Any], list[dict[str, Any]]]:
        """Observation, rewards, dones, infos with `terminal_observation` where an episode ended."""

    def close(self) -> None:
        """Release the simulation."""


@dataclass(frozen=True)
class EpisodeOutcomes:
    """What happened, one entry an episode.

    :param env_id: the environment
    :param seed: of episode 0; episode i had seed + i
    :param success: (episodes,) `is_success` of the last step
    :param returns: (episodes,) sum of rewards
    :param cost_sums: each cost's sum over the episode, by name, (episodes,)
    :param cost_maxima: each cost's largest value in the episode, by name, (episodes,)
    :param final_distances: (episodes, objects) from each object to its target at the end, metres
    :param lengths: (episodes,) steps
    :param diverged: (episodes,) whether the simulation broke down
    :param deviations: (episodes, 2) mean over the episode and largest, of how far a constraint's
        value is from the required one, metres; None for tasks without a constraint
    :param goal_reached: (episodes,) every object at its target at the end, where the environment
        tells it apart from success (constrained tasks); else None
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

    @property
    def episodes(self) -> int:
        """How many episodes were run."""
        return len(self.success)

    @property
    def success_rate(self) -> float:
        """SR: share of episodes that ended in success."""
        return float(self.success.mean())

    @property
    def confidence_interval(self) -> tuple[float, float]:
        """95% Wilson score interval of the success rate."""
        interval = binomtest(int(self.success.sum()), self.episodes).proportion_ci(method="wilson")
        return float(interval.low), float(interval.high)

    @property
    def constraint_met_rate(self) -> float | None:
        """CMR: share of episodes without any `cost_distance`, that is in the band at every step;
        None without one.
        """
        distance = self.cost_sums.get("cost_distance")
        return None if distance is None else float((distance == 0.0).mean())

    @property
    def goal_success_rate(self) -> float | None:
        """GSR: share of episodes with the goal reached at the end, constraint or not; None where
        not told apart.
        """
        return None if self.goal_reached is None else float(self.goal_reached.mean())

    def summary(self) -> dict[str, Any]:
        """:return: JSON-able figures; a rate that the environment does not define is left out"""
        low, high = self.confidence_interval
        values: dict[str, Any] = {
            "env": self.env_id,
            "seed": self.seed,
            "episodes": self.episodes,
            "success_rate": self.success_rate,
            "ci95": [low, high],
            "return_mean": float(self.returns.mean()),
            "length_mean": float(self.lengths.mean()),
            "final_distance_mean": self.final_distances.mean(axis=0).tolist(),
            "diverged": int(self.diverged.sum()),
            "cost_means": {name: float(sums.mean()) for name, sums in self.cost_sums.items()},
        }
        if self.deviations is not None:
            values["deviation_mean"] = float(self.deviations[:, 0].mean())
            values["deviation_worst"] = float(self.deviations[:, 1].max())
        for name in CONSTRAINT_RATES:
            rate = getattr(self, name)
            if rate is not None:
                values[name] = rate
        return values


def evaluate_policy(
    predict: Predict,
    env_id: str,
    *,
    episodes: int = 100,
    seed: int = 0,
    env_kwargs: Mapping[str, Any] | None = None,
    n_envs: int | None = None,
    threads: int = 1,
    frame_callback: FrameCallback | None = None,
    progress: bool = False,
) -> EpisodeOutcomes:
    """Run evaluation episodes of one policy.

    :param predict: batched Dict observation (n, size) -> actions (n, action_size); deterministic
    :param env_id: a registered id such as "DualJacoPush-v0"
    :param episodes: how many
    :param seed: of episode 0; episode i starts from seed + i
    :param env_kwargs: further arguments of the environment
    :param n_envs: environments side by side, by default at most 16; does not change which episodes
        are run
    :param threads: native threads of the simulation; does not change what happens in it
    :param frame_callback: for recording; see `FrameCallback`
    :param progress: show a progress bar
    :raises ValueError: for a number of episodes, environments or threads below 1
    """
    _check_counts(episodes=episodes, n_envs=n_envs)
    # Imported here: only this function needs a simulator, the outcomes can be read without one.
    from saver_envs.envs.sb3_vec_env import SaverVecEnv

    n_envs = min(episodes, DEFAULT_N_ENVS if n_envs is None else n_envs)
    vec_env = SaverVecEnv(env_id, n_envs=n_envs, seed=seed, threads=threads, **(env_kwargs or {}))
    try:
        return run_episodes(
            predict,
            vec_env,
            env_id=env_id,
            episodes=episodes,
            seed=seed,
            frame_callback=frame_callback,
            progress=progress,
        )
    finally:
        vec_env.close()


def run_episodes(
    predict: Predict,
    vec_env: EpisodeVecEnv,
    *,
    env_id: str,
    episodes: int,
    seed: int = 0,
    frame_callback: FrameCallback | None = None,
    progress: bool = False,
) -> EpisodeOutcomes:
    """The same on a vector env of yours, which stays open.

    :param predict: as for `evaluate_policy`
    :param vec_env: the environments
    :param env_id: what to call them in the outcomes
    :param episodes: how many
    :param seed: of episode 0
    :param frame_callback: see `FrameCallback`
    :param progress: show a progress bar
    :raises ValueError: for a number of episodes below 1
    """
    _check_counts(episodes=episodes)
    records: list[_Record] = []
    with _progress_bar(episodes, progress) as bar:
        while len(records) < episodes:
            batch = _run_batch(predict, vec_env, len(records), seed, frame_callback)
            # The last batch may run more episodes than were asked for; they are not counted.
            batch = batch[: episodes - len(records)]
            records += batch
            bar.update(len(batch))
    return _outcomes(records, env_id, seed)


@dataclass
class _Record:
    """One episode while it runs."""

    total: float = 0.0
    length: int = 0
    done: bool = False
    cost_sums: dict[str, float] = field(default_factory=dict)
    cost_maxima: dict[str, float] = field(default_factory=dict)
    diverged: bool = False
    deviation_sum: float = 0.0
    deviation_largest: float = 0.0
    final_info: Mapping[str, Any] = field(default_factory=dict)

    def add(self, reward: float, done: bool, info: Mapping[str, Any], deviation: float) -> None:
        self.total += reward
        self.length += 1
        self.deviation_sum += deviation
        self.deviation_largest = max(self.deviation_largest, deviation)
        self.diverged |= bool(info.get("diverged", False))
        for name, value in info.items():
            if name == "cost" or name.startswith("cost_"):
                self.cost_sums[name] = self.cost_sums.get(name, 0.0) + float(value)
                self.cost_maxima[name] = max(self.cost_maxima.get(name, -np.inf), float(value))
        if done:
            self.done = True
            self.final_info = info


def _run_batch(
    predict: Predict,
    vec_env: EpisodeVecEnv,
    first: int,
    seed: int,
    frame_callback: FrameCallback | None,
) -> list[_Record]:
    """Run one episode in every environment, of numbers first, first + 1, ...; the autoreset ones
    are ignored.
    """
    records = [_Record() for _ in range(vec_env.num_envs)]
    observation = vec_env.reset_episodes([seed + first + k for k in range(vec_env.num_envs)])
    for step in range(LONGEST_EPISODE):
        if frame_callback is not None:
            frame_callback(vec_env, first, step)
        observation, rewards, dones, infos = vec_env.step(predict(observation))
        for index, (record, info) in enumerate(zip(records, infos, strict=True)):
            if not record.done:
                reached = info.get("terminal_observation") if dones[index] else None
                if reached is None:
                    reached = {key: observation[key][index] for key in GOALS}
                deviation = _deviation(reached)
                record.add(float(rewards[index]), bool(dones[index]), info, deviation)
        if all(record.done for record in records):
            return records
    raise RuntimeError(
        f"an episode did not end within {LONGEST_EPISODE} steps: the environment must truncate"
    )


def _outcomes(records: list[_Record], env_id: str, seed: int) -> EpisodeOutcomes:
    infos = [record.final_info for record in records]
    names = records[0].cost_sums
    reached_key = next((key for key in ("goal_reached", "goal_success") if key in infos[0]), None)
    return EpisodeOutcomes(
        env_id=env_id,
        seed=seed,
        success=np.array([bool(info["is_success"]) for info in infos]),
        returns=np.array([record.total for record in records]),
        cost_sums={
            name: np.array([record.cost_sums[name] for record in records]) for name in names
        },
        cost_maxima={
            name: np.array([record.cost_maxima[name] for record in records]) for name in names
        },
        final_distances=np.stack(
            [_final_distances(info["terminal_observation"]) for info in infos]
        ),
        lengths=np.array([record.length for record in records]),
        diverged=np.array([record.diverged for record in records]),
        deviations=np.array(
            [(record.deviation_sum / record.length, record.deviation_largest) for record in records]
        )
        if "cost_distance" in names
        else None,
        goal_reached=None
        if reached_key is None
        else np.array([bool(info[reached_key]) for info in infos]),
    )


def _deviation(observation: Mapping[str, NDArray[Any]]) -> float:
    """:return: metres between a constraint's value, the goal's last entry, and the required one; 0
    without a constraint
    """
    achieved, desired = (observation[key] for key in GOALS)
    return float(abs(achieved[-1] - desired[-1])) if len(achieved) % POINT_SIZE else 0.0


def _final_distances(observation: Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
    """:return: (objects,) metres between each object and its target"""
    difference = np.asarray(observation["achieved_goal"], float) - np.asarray(
        observation["desired_goal"], float
    )
    objects = len(difference) // POINT_SIZE
    distances: NDArray[np.float64] = np.linalg.norm(
        difference[: objects * POINT_SIZE].reshape(objects, POINT_SIZE), axis=1
    )
    return distances


def _check_counts(**counts: int | None) -> None:
    for name, value in counts.items():
        if value is not None and value < 1:
            raise ValueError(f"{name}={value} must be at least 1")


def _progress_bar(total: int, shown: bool) -> Any:
    from tqdm import tqdm

    return tqdm(total=total, unit="episode", disable=not shown)
