"""Read the episodes of a training run's replay buffer."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saver_advisors.datasets.recorded_episodes import RecordedEpisode
from saver_advisors.learner.algorithms import episode_horizon
from saver_advisors.learner.episodes import EpisodeBuffer, StoredEpisode
from saver_advisors.training.building import build_env
from saver_advisors.training.checkpoint import REPLAY_FILE, find_checkpoint, read_state
from saver_advisors.training.run_folder import read_record
from saver_advisors.training.settings import RunConfig
from saver_envs.tasks.contract import Task


@dataclass(frozen=True)
class RunReplay:
    """The replay buffer of a run.

    :param config: of the run
    :param steps: environment steps that the run had done
    :param buffer: with the run's episodes
    :param task: of the environment that it trained in
    """

    config: RunConfig
    steps: int
    buffer: EpisodeBuffer
    task: Task

    @property
    def env_kwargs(self) -> dict[str, Any]:
        """Keyword arguments of the environment that it trained in."""
        return {**self.config.env_kwargs, **self.config.train_env_kwargs}

    def episodes(self, newest: int | None = None) -> Iterator[RecordedEpisode]:
        """Return the ended episodes, oldest first.

        Actions are as the buffer stores them, rewards are computed from the goals as the
        environment computes them, and the infos have ``is_success`` (whether the goal is reached),
        ``advised``, and ``cost_collision`` if the run learned costs. Seeds are not stored.

        :param newest: only this many of the newest episodes; all if None
        """
        stored = list(self.buffer.ended_slots())
        for slot in stored[0 if newest is None else max(0, len(stored) - newest) :]:
            yield self._episode(self.buffer.stored_episode(slot))

    def _episode(self, stored: StoredEpisode) -> RecordedEpisode:
        steps = len(stored.action)
        desired = np.broadcast_to(stored.desired_goal, stored.achieved_goal.shape)
        reward, reached = self.task.reward_and_reached(stored.achieved_goal, desired)
        infos = {"is_success": reached, "advised": _after_reset(stored.advised)}
        if self.buffer.cost_key is not None:
            infos[self.buffer.cost_key] = _after_reset(stored.cost)
        return RecordedEpisode(
            observations={
                "observation": stored.observation,
                "achieved_goal": stored.achieved_goal,
                "desired_goal": desired.copy(),
            },
            actions=stored.action,
            rewards=np.asarray(reward[1:], np.float32),
            terminations=np.zeros(steps, bool),
            truncations=np.arange(steps) == steps - 1,
            infos=infos,
        )


def read_replay(folder: Path) -> RunReplay:
    """Read the replay buffer of a run of ``saver train``.

    :param folder: of the run
    :return: the replay buffer, with the run's settings
    :raises FileNotFoundError: if the run has no checkpoint, or a file of it is missing
    :raises ValueError: if a file is damaged, or not that of a run
    """
    record = read_record(folder)
    checkpoint = find_checkpoint(folder / "latest")
    if checkpoint is None:
        raise FileNotFoundError(f"{folder} has no checkpoint, and so no replay buffer")
    state = read_state(checkpoint)  # verified before an environment's module runs
    config = RunConfig.from_mapping(record["config"])
    with closing(build_env(config)) as env:
        task = env.get_attr("episodes", indices=[0])[0].task
        buffer = EpisodeBuffer(
            config.buffer_size,
            env.observation_space,
            env.action_space,
            "cpu",
            n_envs=config.n_envs,
            horizon=episode_horizon(env),
            cost_key=config.cost_key if config.learns_costs else None,
        )
    buffer.load_npz(checkpoint / REPLAY_FILE)
    if not any(True for _ in buffer.ended_slots()):
        raise ValueError(f"{checkpoint / REPLAY_FILE} holds no ended episode yet")
    return RunReplay(config, int(state["steps"]), buffer, task)


def _after_reset(values: NDArray[Any]) -> NDArray[Any]:
    """Put the value of the reset, 0, before those of the steps."""
    return np.concatenate((np.zeros_like(values[:1]), values))
