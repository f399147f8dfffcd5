"""Data sets of Minari: what is read back equals what was played."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

minari = pytest.importorskip("minari")

from short_episodes import SEEDS, SHORT, assert_same, expert, recorded  # noqa: E402

from saver_advisors.datasets.minari_files import write_minari  # noqa: E402
from saver_advisors.datasets.recorded_episodes import RecordedEpisode  # noqa: E402
from saver_envs.registration import ENVIRONMENTS  # noqa: E402

NAME = "saver/test/expert-v0"


def write(
    episodes: list[RecordedEpisode], env_id: str = "JacoPush-v0", **options: Any
) -> minari.MinariDataset:
    write_minari(
        NAME,
        episodes,
        env_id,
        {**SHORT, **options},
        algorithm="scripted expert",
        description="of a test",
        about={"seed": 3},
    )
    return minari.load_dataset(NAME)


def assert_read_back(dataset: minari.MinariDataset, episodes: list[RecordedEpisode]) -> None:
    assert dataset.total_episodes == len(episodes)
    assert dataset.total_steps == sum(map(len, episodes))
    stored = dataset.storage.get_episode_metadata(dataset.episode_indices)
    assert [one.get("seed") for one in stored] == [one.seed for one in episodes]
    for read, played in zip(dataset.iterate_episodes(), episodes, strict=True):
        assert_same(played.observations, read.observations)
        assert_same(played.infos, read.infos)
        for name in ("actions", "rewards", "terminations", "truncations"):
            assert_same(getattr(played, name), getattr(read, name))
        assert all(dataset.observation_space.contains(row) for row in rows_of(read.observations))
        assert all(dataset.action_space.contains(row) for row in read.actions)


def rows_of(observations: dict[str, np.ndarray]) -> list[dict[str, np.ndarray]]:
    steps = len(observations["observation"])
    return [{key: rows[step] for key, rows in observations.items()} for step in range(steps)]


def assert_played_again(dataset: minari.MinariDataset) -> None:
    """Play an episode in the environment that the data set makes."""
    episode = dataset[0]
    env = dataset.recover_environment()
    (about,) = dataset.storage.get_episode_metadata([0])
    seen, _ = env.reset(seed=about["seed"])
    assert_same({key: rows[0] for key, rows in episode.observations.items()}, seen)
    for step, action in enumerate(episode.actions):
        seen, reward, terminated, truncated, info = env.step(action)
        assert_same({key: rows[step + 1] for key, rows in episode.observations.items()}, seen)
        assert (reward, terminated, truncated) == (
            episode.rewards[step],
            episode.terminations[step],
            episode.truncations[step],
        )
        assert info["is_success"] == episode.infos["is_success"][step + 1]
    assert truncated
    env.close()


def test_round_trip(sets: Path) -> None:
    options = {"randomization": "mild", "report_parameters": True}
    episodes = recorded(expert(**options), **options)
    dataset = write(episodes, **options)
    assert_read_back(dataset, episodes)
    assert_played_again(dataset)
    metadata = json.loads((sets / NAME / "data" / "metadata.json").read_text())
    assert metadata["saver"] == {"seed": 3}
    assert metadata["algorithm_name"] == "scripted expert"
    assert not list(sets.rglob("*.pkl"))


@pytest.mark.slow
@pytest.mark.parametrize("env_id", [one for one in ENVIRONMENTS if one != "JacoPush-v0"])
def test_round_trip_of_every_id(env_id: str, sets: Path) -> None:
    episodes = recorded(expert(env_id), env_id)
    dataset = write(episodes, env_id)
    assert_read_back(dataset, episodes)
    assert_played_again(dataset)


def test_the_makers_speeds_have_their_own_horizon(sets: Path) -> None:
    env_kwargs = {"rated": True}
    write_minari(
        NAME,
        recorded(expert()),
        "JacoPush-v0",
        env_kwargs,
        algorithm="none",
        description="none",
        about={},
    )
    spec = minari.load_dataset(NAME).spec.env_spec
    assert spec.max_episode_steps == 125
    assert spec.kwargs == {"env_id": "JacoPush-v0", "rated": True}


def test_many_episodes_are_written_in_parts(sets: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("saver_advisors.datasets.minari_files._AT_ONCE", 2)
    episodes = recorded(expert())
    assert_read_back(write(episodes), episodes)


def test_a_data_set_is_not_replaced(sets: Path) -> None:
    episodes = recorded(expert())
    write(episodes)
    with pytest.raises(FileExistsError, match="exists: choose another name"):
        write(episodes)


def test_nothing_is_left_of_one_that_fails(sets: Path) -> None:
    def broken() -> Any:
        yield from recorded(expert())
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write(broken())
    assert not (sets / NAME).exists()


@pytest.mark.parametrize("name", ["", "no/version-v", "a b/expert-v0", "../expert-v0"])
def test_names_that_are_none(name: str, sets: Path) -> None:
    with pytest.raises(ValueError, match="name="):
        write_minari(name, [], "JacoPush-v0", {}, algorithm="", description="", about={})


def test_no_episode(sets: Path) -> None:
    with pytest.raises(ValueError, match="at least one"):
        write([])


@pytest.mark.slow
def test_the_example_learns_from_one(sets: Path, tmp_path: Path) -> None:
    write(recorded(expert()))
    example = Path(__file__).resolve().parents[2] / "docs" / "examples" / "offline_learning.py"
    words = ["--updates", "4", "--width", "8", "--episodes", "2"]
    done = subprocess.run(
        [sys.executable, str(example), NAME, *words], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "data: 18 steps of 3 episodes" in done.stdout
    for algorithm in ("behaviour cloning", "TD3+BC"):
        assert f"{algorithm}: success " in done.stdout
    assert SEEDS[0] >= 1_000_000
