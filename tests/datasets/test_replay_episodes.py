"""Episodes of a replay buffer: as they were stored, in order, without those that still run."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tiny_runs import TINY_RUN

from saver_advisors.datasets.replay_episodes import read_replay
from saver_advisors.training.launch import train


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of four episodes, half of whose steps may be advised."""
    folder = tmp_path_factory.mktemp("runs") / "tiny"
    values = TINY_RUN.to_mapping()
    values["advice"] = {"strategy": "early", "teacher": "jaco-push", "budget": 20}
    train(TINY_RUN.from_mapping(values), folder, progress=False)
    return folder


def test_episodes_are_as_they_were_stored(run_dir: Path) -> None:
    replay = read_replay(run_dir)
    episodes = list(replay.episodes())
    assert replay.steps == 40
    assert [len(one) for one in episodes] == [10] * 4
    assert [one.seed for one in episodes] == [None] * 4
    buffer = replay.buffer
    for slot, episode in enumerate(episodes):
        np.testing.assert_array_equal(
            episode.observations["observation"], buffer.observation[slot], strict=True
        )
        np.testing.assert_array_equal(episode.actions, buffer.action[slot], strict=True)
        distance = np.linalg.norm(
            episode.observations["achieved_goal"] - episode.observations["desired_goal"], axis=1
        )
        np.testing.assert_array_equal(episode.infos["is_success"], distance <= 0.05)
        np.testing.assert_array_equal(episode.rewards, np.float32(distance[1:] <= 0.05) - 1)
        assert episode.truncations.tolist() == [False] * 9 + [True]
        assert not episode.infos["advised"][0]
    advised = [int(one.infos["advised"].sum()) for one in episodes]
    assert sum(advised) == 20
    assert [len(one) for one in replay.episodes(newest=1)] == [10]
    (newest,) = replay.episodes(newest=1)
    np.testing.assert_array_equal(newest.actions, episodes[-1].actions)


def test_the_oldest_comes_first_and_running_ones_are_left_out(run_dir: Path) -> None:
    buffer = read_replay(run_dir).buffer
    assert buffer.ended_slots().tolist() == [0, 1, 2, 3]
    buffer._running[:] = [False, True]
    assert buffer.ended_slots().tolist() == [slot for slot in range(4) if slot != buffer._slot[1]]
    buffer.length[:] = 10
    buffer.full, buffer.pos = True, 7
    buffer._running[:] = False
    assert buffer.ended_slots().tolist()[:2] == [7, 8]
    assert len(buffer.ended_slots()) == buffer.n_slots


def test_costs_come_along(tmp_path: Path) -> None:
    config = replace(TINY_RUN, contact_cost=0.5)
    train(config, tmp_path / "run", progress=False)
    (episode, *_) = read_replay(tmp_path / "run").episodes()
    assert set(np.unique(episode.infos["cost_collision"])) <= {0.0, 1.0}
    assert len(episode.infos["cost_collision"]) == 11


def test_damage(run_dir: Path, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        read_replay(tmp_path)
    (tmp_path / "run.json").write_text(json.dumps({"config": {}, "sessions": []}))
    with pytest.raises(FileNotFoundError, match="no checkpoint"):
        read_replay(tmp_path)
    (tmp_path / "latest").symlink_to(run_dir / "latest")
    record = json.loads((run_dir / "run.json").read_text())
    record["config"]["env_kwargs"] = {"max_episode_steps": 9}
    (tmp_path / "run.json").write_text(json.dumps(record))
    with pytest.raises(ValueError, match="horizon is 10, this buffer's is 9"):
        read_replay(tmp_path)
