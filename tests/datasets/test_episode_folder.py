"""Episodes that are kept one file each: what comes back is what went in, whatever happened."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from saver_advisors.datasets.actors import Actor
from saver_advisors.datasets.episode_folder import EpisodeFolder
from saver_advisors.datasets.recorded_episodes import RecordedEpisode, record_episodes

OPTIONS: dict[str, Any] = {
    "max_episode_steps": 3,
    "randomization": "wide",
    "report_parameters": True,
}
ABOUT = {"env": "JacoPush-v0", "env_kwargs": OPTIONS}


@pytest.fixture(scope="module")
def episodes() -> list[RecordedEpisode]:
    actor = Actor(lambda seen: np.full((len(seen["observation"]), 3), 0.5, np.float32))
    return list(record_episodes(actor, "JacoPush-v0", [7, 8, 9], OPTIONS))


def assert_same(read: Any, made: Any) -> None:
    """Compare arrays, or mappings of them."""
    if isinstance(made, dict):
        assert list(read) == list(made)
        for name in made:
            assert_same(read[name], made[name])
    else:
        np.testing.assert_array_equal(read, made, strict=True)


def test_episodes_come_back(episodes: list[RecordedEpisode], tmp_path: Path) -> None:
    assert isinstance(episodes[0].infos["parameters"], dict)
    kept = EpisodeFolder(tmp_path / "kept", ABOUT)
    assert (len(kept), kept.next_seed) == (0, 0)
    kept.add(episodes[0])
    kept = EpisodeFolder(tmp_path / "kept", ABOUT)  # as the next process does
    kept.add(episodes[1])
    assert (len(kept), kept.next_seed) == (2, 9)
    for read, made in zip(kept, episodes[:2], strict=True):
        for name, value in vars(made).items():
            assert_same(getattr(read, name), value)
    kept.remove()
    assert not kept.path.exists()


def test_an_episode_that_was_not_written_whole_is_no_episode(
    episodes: list[RecordedEpisode], tmp_path: Path
) -> None:
    kept = EpisodeFolder(tmp_path, ABOUT)
    kept.add(episodes[0])
    whole = (tmp_path / "000000.npz").read_bytes()
    (tmp_path / "000001.npz.4711.partial").write_bytes(whole[:500])  # killed while it wrote
    assert len(EpisodeFolder(tmp_path, ABOUT)) == 1
    kept.add(episodes[1])
    assert [one.seed for one in kept] == [7, 8]


def test_mistakes(episodes: list[RecordedEpisode], tmp_path: Path) -> None:
    kept = EpisodeFolder(tmp_path, ABOUT)
    kept.add(episodes[0])
    with pytest.raises(ValueError, match=r"has episodes of .*JacoPush.* not of .*MicoPush"):
        EpisodeFolder(tmp_path, {**ABOUT, "env": "MicoPush-v0"})
    whole = (tmp_path / "000000.npz").read_bytes()
    for damaged in (b"", whole[:500], b"PK" + whole[2:600]):
        (tmp_path / "000000.npz").write_bytes(damaged)
        with pytest.raises(ValueError, match=r"000000\.npz is not an episode"):
            list(kept)
