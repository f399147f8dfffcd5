"""Play episodes with fixed seeds and keep every step of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saver_advisors.datasets.actors import Actor
from saver_advisors.evaluation.episodes import N_ENVS, EpisodeStep, Observation, play
from saver_envs.envs.sb3_vec_env import SaverVecEnv

#: Entries of ``info`` that the vector env adds.
_ADDED = ("terminal_observation", "TimeLimit.truncated")


@dataclass(frozen=True)
class RecordedEpisode:
    """An episode of T steps.

    :param observations: entries (T + 1, size), float32, the first from the reset
    :param actions: (T, action size), float32, in [-1, 1]
    :param rewards: (T,), float32
    :param terminations: (T,)
    :param truncations: (T,)
    :param infos: arrays (T + 1, ...) by name, possibly nested; entry 0 is from the reset, and entry
        t + 1 from the step with action t
    :param seed: of the reset; None if it is not known
    """

    observations: Observation
    actions: NDArray[np.float32]
    rewards: NDArray[np.float32]
    terminations: NDArray[np.bool_]
    truncations: NDArray[np.bool_]
    infos: Mapping[str, Any]
    seed: int | None = None

    @property
    def success(self) -> bool:
        """Whether the episode ends in success; False if its infos do not tell."""
        return "is_success" in self.infos and bool(self.infos["is_success"][-1])

    def __len__(self) -> int:
        return len(self.rewards)


def record_episodes(
    actor: Actor,
    env_id: str,
    seeds: Sequence[int],
    env_kwargs: Mapping[str, Any] | None = None,
) -> Iterator[RecordedEpisode]:
    """Play an episode from each seed.

    An episode depends on its seed only, and not on which episodes are played beside it.

    :param actor: chooses the actions
    :param env_id: a registered id
    :param seeds: of the episodes, at least one
    :param env_kwargs: keyword arguments of the environment
    :return: the episodes in the order of the seeds
    :raises ValueError: without a seed, or for an invalid id or keyword argument
    """
    if not seeds:
        raise ValueError(f"seeds={seeds!r}: must have at least one seed")
    n_envs = min(len(seeds), N_ENVS)
    with closing(SaverVecEnv(env_id, n_envs=n_envs, **(env_kwargs or {}))) as env:
        for first in range(0, len(seeds), n_envs):
            batch = list(seeds[first : first + n_envs])
            # The last batch may contain surplus episodes.
            surplus = [batch[-1]] * (n_envs - len(batch))
            yield from _play_batch(actor, env, [*batch, *surplus])[: len(batch)]


def _play_batch(actor: Actor, env: SaverVecEnv, seeds: list[int]) -> list[RecordedEpisode]:
    actor.begin(seeds)
    played: list[tuple[NDArray[np.float32], Mapping[str, NDArray[Any]]]] = []

    def act(observation: Observation) -> NDArray[np.float32]:
        actions, notes = actor.act(observation)
        actions = np.clip(np.asarray(actions, np.float32), -1.0, 1.0)
        played.append((actions, notes))
        return actions

    tapes = [EpisodeTape(seed) for seed in seeds]
    for step in play(act, env, seeds):
        for index in np.flatnonzero(step.running).tolist():
            if step.number == 0:
                tapes[index].begin(step, index, env.reset_infos[index])
            else:
                tapes[index].add(step, index, *played[-1])
    return [tape.episode() for tape in tapes]


class EpisodeTape:
    """Collects the steps of one episode.

    :param seed: of the episode
    """

    def __init__(self, seed: int) -> None:
        self.seed = seed
        self.observations: list[Observation] = []
        self.actions: list[NDArray[np.float32]] = []
        self.rewards: list[float] = []
        self.dones: list[bool] = []
        self.infos: list[dict[str, Any]] = []

    def begin(self, step: EpisodeStep, index: int, info: Mapping[str, Any]) -> None:
        """Keep what the reset returned for environment ``index``."""
        self.observations.append({key: rows[index] for key, rows in step.observation.items()})
        self.infos.append(dict(info))

    def add(
        self,
        step: EpisodeStep,
        index: int,
        actions: NDArray[np.float32],
        notes: Mapping[str, NDArray[Any]],
    ) -> None:
        """Keep a step of environment ``index``."""
        info, done = dict(step.infos[index]), bool(step.dones[index])
        # After an autoreset the batch holds the next episode's observation.
        seen = info["terminal_observation"] if done else None
        self.observations.append(
            seen or {key: rows[index] for key, rows in step.observation.items()}
        )
        for name, values in notes.items():
            info[name] = values[index]
            self.infos[0].setdefault(name, np.zeros_like(values[index]))
        self.infos.append({key: one for key, one in info.items() if key not in _ADDED})
        self.actions.append(actions[index])
        self.rewards.append(step.rewards[index])
        self.dones.append(done)

    def total(self, name: str) -> float:
        """Return the sum of an entry of the infos of all steps so far."""
        return float(sum(info[name] for info in self.infos[1:]))

    def episode(self) -> RecordedEpisode:
        """Return the episode."""
        return RecordedEpisode(
            observations=_stacked(self.observations),
            actions=np.stack(self.actions),
            rewards=np.asarray(self.rewards, np.float32),
            terminations=np.zeros(len(self.dones), bool),  # only the clock ends episodes
            truncations=np.asarray(self.dones),
            infos=_stacked(self.infos),
            seed=self.seed,
        )


def _stacked(steps: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Turn a list of mappings into a mapping of arrays."""
    stacked: dict[str, Any] = {}
    for key, first in steps[0].items():
        values = [step[key] for step in steps]
        stacked[key] = _stacked(values) if isinstance(first, Mapping) else np.stack(values)
    return stacked
