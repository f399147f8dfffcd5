"""Data sets of LeRobot: pictures and numbers are those of the episodes; the check finds faults."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
import pandas as pd
import pytest

pytest.importorskip("pyarrow")

from short_episodes import SEEDS, SHORT, expert, recorded

from saver_advisors.datasets import lerobot_layout as layout
from saver_advisors.datasets.lerobot_check import check_lerobot
from saver_advisors.datasets.lerobot_files import write_lerobot
from saver_advisors.datasets.lerobot_statistics import (
    histogram,
    picture_statistics,
    vector_statistics,
)
from saver_advisors.datasets.recorded_episodes import RecordedEpisode
from saver_envs.envs.goal_env import SaverGoalEnv

CAMERAS, SIZE = ("front", "overhead"), (64, 48)


@pytest.fixture(scope="module")
def episodes() -> list[RecordedEpisode]:
    return recorded(expert())


@pytest.fixture(scope="module")
def written(episodes: list[RecordedEpisode], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three episodes in two files."""
    folder = tmp_path_factory.mktemp("lerobot") / "push"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(layout, "EPISODES_PER_FILE", 2)
        write_lerobot(folder, episodes, "JacoPush-v0", SHORT, cameras=CAMERAS, size=SIZE)
    return folder


def read(folder: Path, under: str) -> pd.DataFrame:
    paths = sorted((folder / under).glob("chunk-*/*.parquet"))
    return pd.concat([pd.read_parquet(path) for path in paths], ignore_index=True)


def frames_of(path: Path) -> np.ndarray:
    reader = imageio_ffmpeg.read_frames(str(path))
    width, height = next(reader)["size"]
    return np.stack([np.frombuffer(one, np.uint8).reshape(height, width, 3) for one in reader])


def test_the_files_of_the_layout(written: Path) -> None:
    found = {str(path.relative_to(written)) for path in written.rglob("*") if path.is_file()}
    numbered = [f"chunk-000/file-00{number}" for number in (0, 1)]
    videos = {f"videos/observation.images.{c}/{n}.mp4" for c in CAMERAS for n in numbered}
    tables = {f"{kind}/{n}.parquet" for kind in ("data", "meta/episodes") for n in numbered}
    meta = {"meta/info.json", "meta/stats.json", "meta/tasks.parquet"}
    assert found == videos | tables | meta
    info = check_lerobot(written)
    assert (info["codebase_version"], info["fps"], info["robot_type"]) == ("v3.0", 25, "jaco")
    assert info["features"]["observation.state"]["shape"] == [28]
    assert info["features"]["observation.state"]["names"][0] == "arm0 gripper position 0"


def test_the_numbers_are_those_of_the_episodes(
    written: Path, episodes: list[RecordedEpisode]
) -> None:
    frames, rows = read(written, "data"), read(written, "meta/episodes")
    assert rows["seed"].tolist() == list(SEEDS)
    for number, episode in enumerate(episodes):
        own = frames[frames["episode_index"] == number]
        for name, wanted in (
            ("observation.state", episode.observations["observation"][:-1]),
            ("observation.environment_state", episode.observations["desired_goal"][:-1]),
            ("action", episode.actions),
            ("next.reward", episode.rewards),
            ("next.done", episode.truncations),
            ("next.success", episode.infos["is_success"][1:]),
        ):
            np.testing.assert_array_equal(np.stack(own[name].to_numpy()), wanted, strict=True)
        np.testing.assert_allclose(own["timestamp"], np.arange(len(episode)) / 25, atol=1e-6)


def test_the_pictures_are_those_of_the_steps(
    written: Path, episodes: list[RecordedEpisode]
) -> None:
    rows = read(written, "meta/episodes")
    for camera in CAMERAS:
        key = f"observation.images.{camera}"
        env = SaverGoalEnv(
            "JacoPush-v0", "rgb_array", width=64, height=48, camera_name=camera, **SHORT
        )
        for number, episode in enumerate(episodes):
            place = {
                "chunk_index": rows[f"videos/{key}/chunk_index"][number],
                "file_index": rows[f"videos/{key}/file_index"][number],
            }
            shown = frames_of(written / layout.VIDEO_PATH.format(video_key=key, **place))
            first = round(rows[f"videos/{key}/from_timestamp"][number] * 25)
            env.reset(seed=episode.seed)
            for step, action in enumerate(episode.actions):
                drawn = env.render().astype(float)
                difference = np.abs(shown[first + step] - drawn)
                assert difference.mean() < 4.0  # of 255: the video is compressed
                env.step(action)
        env.close()


def test_statistics_of_vectors() -> None:
    values = np.array([[0.0, 1.0], [2.0, 1.0], [4.0, 1.0]], np.float32)
    found = vector_statistics(values)
    assert found["min"] == [0.0, 1.0]
    assert found["max"] == [4.0, 1.0]
    assert found["mean"] == [2.0, 1.0]
    np.testing.assert_allclose(found["std"], [np.sqrt(8 / 3), 0.0])
    assert found["q50"] == [2.0, 1.0]
    assert found["count"] == [3]


def test_statistics_of_pictures() -> None:
    frames = np.random.default_rng(0).integers(10, 200, (5, 8, 6, 3)).astype(np.uint8)
    found = picture_statistics(sum(histogram(one) for one in frames), 5)  # type: ignore[arg-type]
    pixels = frames.reshape(-1, 3) / 255
    for name, wanted in (
        ("min", pixels.min(0)),
        ("max", pixels.max(0)),
        ("mean", pixels.mean(0)),
        ("std", pixels.std(0)),
        ("q90", np.quantile(pixels, 0.9, axis=0, method="inverted_cdf")),
    ):
        np.testing.assert_allclose(found[name], wanted.reshape(3, 1, 1), err_msg=name)
    assert found["count"] == [5]


def changed(path: str, change: Callable[[Any], None]) -> Callable[[Path], None]:
    """A fault: a JSON file with another value."""

    def make(folder: Path) -> None:
        content = json.loads((folder / path).read_text())
        change(content)
        (folder / path).write_text(json.dumps(content))

    return make


def column(path: str, name: str, values: Callable[[Any], Any]) -> Callable[[Path], None]:
    """A fault: a table with another column."""

    def make(folder: Path) -> None:
        table = pd.read_parquet(folder / path)
        table[name] = values(table[name])
        table.to_parquet(folder / path)

    return make


DATA, META = "data/chunk-000/file-001.parquet", "meta/episodes/chunk-000/file-001.parquet"
VIDEO = "videos/observation.images.front/chunk-000/file-001.mp4"
FAULTS = {
    "frames": (changed("meta/info.json", lambda one: one.update(total_frames=5)), "rows of data"),
    "version": (changed("meta/info.json", lambda one: one.update(codebase_version="v2")), "v3.0"),
    "rate": (changed("meta/info.json", lambda one: one.update(fps=30)), "timestamp"),
    "mean": (changed("meta/stats.json", lambda one: one["action"].update(mean=[9, 9, 9])), "mean"),
    "index": (column(DATA, "index", lambda one: one + 1), "indices of frames"),
    "type": (column(DATA, "next.done", lambda one: one.astype(int)), "type of next.done"),
    "borders": (column(META, "dataset_to_index", lambda one: one - 1), "borders"),
    "times": (
        column(META, "videos/observation.images.front/to_timestamp", lambda one: one + 1),
        "times of the episodes",
    ),
    "video": (lambda folder: (folder / VIDEO).unlink(), "is missing"),
    "other video": (
        lambda folder: (folder / VIDEO).write_bytes(
            (folder / VIDEO.replace("001.mp4", "000.mp4")).read_bytes()
        ),
        "pictures in",
    ),
}


@pytest.mark.parametrize(("fault", "message"), FAULTS.values(), ids=FAULTS)
def test_the_check_finds(
    fault: Callable[[Path], None], message: str, written: Path, tmp_path: Path
) -> None:
    import shutil

    folder = tmp_path / "copy"
    shutil.copytree(written, folder)
    fault(folder)
    with pytest.raises((ValueError, FileNotFoundError), match=message):
        check_lerobot(folder)


def test_an_episode_that_is_another_when_played_again(
    episodes: list[RecordedEpisode], tmp_path: Path
) -> None:
    other = RecordedEpisode(**{**vars(episodes[0]), "seed": 5})
    with pytest.raises(RuntimeError, match="differs at step 0"):
        write_lerobot(tmp_path / "set", [other], "JacoPush-v0", SHORT, size=SIZE)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"size": (63, 48)}, "size=(63, 48)"),
        ({"cameras": ()}, "cameras=()"),
        ({"cameras": ("front", "front")}, "each once"),
        ({"cameras": ("nowhere",)}, "overhead"),
    ],
)
def test_bad_arguments(
    options: dict[str, Any],
    message: str,
    episodes: list[RecordedEpisode],
    tmp_path: Path,
) -> None:
    with pytest.raises(ValueError) as caught:
        write_lerobot(tmp_path / "set", episodes, "JacoPush-v0", SHORT, **options)
    assert message in str(caught.value)


def test_no_seed_and_no_episode(episodes: list[RecordedEpisode], tmp_path: Path) -> None:
    unknown = RecordedEpisode(**{**vars(episodes[0]), "seed": None})
    with pytest.raises(ValueError, match="without a seed"):
        write_lerobot(tmp_path / "set", [unknown], "JacoPush-v0", SHORT, size=SIZE)
    with pytest.raises(ValueError, match="at least one"):
        write_lerobot(tmp_path / "set", [], "JacoPush-v0", SHORT, size=SIZE)
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "file").touch()
    with pytest.raises(FileExistsError, match="not empty"):
        write_lerobot(tmp_path / "set", episodes, "JacoPush-v0", SHORT, size=SIZE)
