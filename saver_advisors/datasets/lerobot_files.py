"""Write episodes with camera pictures as a LeRobot data set, without the package ``lerobot``."""

from __future__ import annotations

import shutil
from collections.abc import Generator, Iterable, Mapping
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saver_advisors.datasets import lerobot_layout as layout
from saver_advisors.datasets.lerobot_statistics import (
    LEVELS,
    Statistics,
    histogram,
    picture_statistics,
    vector_statistics,
)
from saver_advisors.datasets.recorded_episodes import RecordedEpisode
from saver_advisors.reporting.provenance import write_json_atomic
from saver_advisors.reporting.video import FPS, mp4_writer
from saver_envs.cameras.rendering import DEFAULT_CAMERA
from saver_envs.envs.goal_env import SaverGoalEnv
from saver_envs.envs.pictures import Pictures
from saver_envs.registration import row_of
from saver_envs.validation import require

KEYFRAMES_EVERY = 10
"""Frames from one that is decoded by itself to the next: readers ask for single frames."""

Drawn = dict[str, list[NDArray[np.uint8]]]
"""Pictures (height, width, 3) by camera, one for each step."""


def write_lerobot(
    folder: Path,
    episodes: Iterable[RecordedEpisode],
    env_id: str,
    env_kwargs: Mapping[str, Any],
    *,
    instruction: str | None = None,
    cameras: tuple[str, ...] = (DEFAULT_CAMERA,),
    size: tuple[int, int] = (320, 240),
) -> None:
    """Write a data set. Each episode is played again from its seed and actions, and drawn.

    :param folder: of the data set; must not exist, or be empty
    :param episodes: at least one, with seeds, all with advice or all without
    :param env_id: a registered id
    :param env_kwargs: keyword arguments of the environment
    :param instruction: the task in words; the task's name and when it succeeds if None
    :param cameras: names of cameras of the scene
    :param size: width and height of the pictures, even numbers of pixels
    :raises FileExistsError: if there are files in the folder
    :raises ValueError: without an episode, for an episode without a seed, or an unknown camera
    :raises RuntimeError: if an episode is not the same when it is played again
    """
    even = all(pixels > 0 and pixels % 2 == 0 for pixels in size)
    require("size", size, even, "even numbers of pixels, as videos need")
    require("cameras", cameras, len(set(cameras)) == len(cameras) > 0, "one or more, each once")
    if folder.exists() and any(folder.iterdir()):
        raise FileExistsError(f"{folder} is not empty: choose another folder, or remove it")
    partial = folder.with_name(f".{folder.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    try:
        with closing(_Stage(env_id, env_kwargs, cameras, size)) as stage:
            with _Writer(partial, stage, instruction) as writer:
                for episode in episodes:
                    writer.add(episode)
            writer.finish()
        if folder.exists():
            folder.rmdir()
        partial.rename(folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


class _Stage:
    """The environment in which episodes are played again, and its cameras."""

    def __init__(
        self,
        env_id: str,
        env_kwargs: Mapping[str, Any],
        cameras: tuple[str, ...],
        size: tuple[int, int],
    ) -> None:
        self.cameras, self.size = cameras, size
        self.robot = row_of(env_id).robot
        self.env = SaverGoalEnv(env_id, **env_kwargs)
        episodes = self.env.episodes
        self.pictures = {
            name: Pictures(episodes, "rgb_array", *size, camera=name) for name in cameras
        }
        self.task, self.action_size = episodes.task, episodes.action_size
        succeeds = episodes.task.page(episodes.scene).succeeds
        self.instruction = f"{episodes.task.name}: {succeeds}"

    def draw(self, episode: RecordedEpisode) -> Drawn:
        """Play an episode again, and draw the state before each action."""
        if episode.seed is None:
            raise ValueError("an episode without a seed cannot be drawn: replays have none")
        drawn: Drawn = {name: [] for name in self.cameras}
        seen, _ = self.env.reset(seed=episode.seed)
        for step, action in enumerate(episode.actions):
            self._check(episode, step, seen)
            for name, pictures in self.pictures.items():
                drawn[name].append(np.asarray(pictures.draw(), np.uint8))
            seen, *_ = self.env.step(action)
        self._check(episode, len(episode), seen)
        return drawn

    @staticmethod
    def _check(episode: RecordedEpisode, step: int, seen: Mapping[str, NDArray[Any]]) -> None:
        for key, values in seen.items():
            if not np.array_equal(values, episode.observations[key][step]):
                raise RuntimeError(
                    f"the episode of seed {episode.seed} differs at step {step} when it is played "
                    "again: write its pictures on the machine that played it"
                )

    def close(self) -> None:
        for pictures in self.pictures.values():
            pictures.close()
        self.env.close()


class _Writer(ExitStack):
    """Writes episodes one after another; closing it closes the videos.

    :param folder: of the data set, created here
    :param stage: draws the episodes
    :param instruction: the task in words
    """

    def __init__(self, folder: Path, stage: _Stage, instruction: str | None) -> None:
        super().__init__()
        self.folder, self.stage = folder, stage
        self.instruction = instruction or stage.instruction
        self.features: dict[str, dict[str, Any]] = {}
        self.frames = 0
        self.count = 0
        #: Of the present files: rows of the table of episodes, columns of the table of steps.
        self.rows: list[dict[str, Any]] = []
        self.columns: list[dict[str, NDArray[Any]]] = []
        self.videos: dict[str, Generator[None, NDArray[np.uint8], None]] = {}
        #: Of the whole data set.
        self.vectors: dict[str, list[NDArray[Any]]] = {}
        self.histograms = {name: np.zeros((3, LEVELS), np.int64) for name in stage.cameras}

    def add(self, episode: RecordedEpisode) -> None:
        """Write an episode."""
        advised = "advised" in episode.infos
        if not self.features:
            stage = self.stage
            self.features = layout.features_of(
                stage.task, stage.action_size, advised, stage.cameras, stage.size
            )
        numbers = layout.file_numbers(self.count)
        if self.count % layout.EPISODES_PER_FILE == 0:
            self._next_files(numbers)
        drawn = self.stage.draw(episode)
        columns = layout.columns_of(episode, self.count, self.frames, "advised" in self.features)
        statistics = {name: vector_statistics(values) for name, values in columns.items()}
        statistics |= self._write_frames(drawn)
        self.rows.append(self._row(episode, numbers, statistics))
        self.columns.append(columns)
        for name, values in columns.items():
            self.vectors.setdefault(name, []).append(values)
        self.frames += len(episode)
        self.count += 1

    def _row(
        self, episode: RecordedEpisode, numbers: dict[str, int], statistics: dict[str, Statistics]
    ) -> dict[str, Any]:
        """Return the row of an episode in the table of episodes."""
        row: dict[str, Any] = {
            "episode_index": self.count,
            "tasks": [self.instruction],
            "length": len(episode),
            "dataset_from_index": self.frames,
            "dataset_to_index": self.frames + len(episode),
            "seed": episode.seed,
        }
        before = sum(one["length"] for one in self.rows)
        kinds = ["data", "meta/episodes", *(f"videos/{layout.CAMERA}{c}" for c in self.videos)]
        for kind in kinds:
            row |= {f"{kind}/{name}": number for name, number in numbers.items()}
            if kind.startswith("videos/"):
                row[f"{kind}/from_timestamp"] = before / FPS
                row[f"{kind}/to_timestamp"] = (before + len(episode)) / FPS
        for feature, values in statistics.items():
            row |= {f"stats/{feature}/{name}": value for name, value in values.items()}
        return row

    def _write_frames(self, drawn: Drawn) -> dict[str, Statistics]:
        statistics = {}
        for camera, frames in drawn.items():
            counts = sum((histogram(one) for one in frames), np.zeros((3, LEVELS), np.int64))
            statistics[layout.CAMERA + camera] = picture_statistics(counts, len(frames))
            self.histograms[camera] += counts
            for frame in frames:
                self.videos[camera].send(frame)
        return statistics

    def _next_files(self, numbers: dict[str, int]) -> None:
        """Close the present files, and open the videos of the next."""
        self._write_tables()
        self.close()
        for camera in self.stage.cameras:
            key = layout.CAMERA + camera
            path = self.folder / layout.VIDEO_PATH.format(video_key=key, **numbers)
            path.parent.mkdir(parents=True, exist_ok=True)
            writer = mp4_writer(path, *self.stage.size, keyframes_every=KEYFRAMES_EVERY)
            self.videos[camera] = self.enter_context(closing(writer))

    def _write_tables(self) -> None:
        """Write the tables of the present files."""
        if not self.rows:
            return
        import pyarrow as pa

        numbers = layout.file_numbers(self.count - 1)
        joined = {
            name: np.concatenate([one[name] for one in self.columns]) for name in self.columns[0]
        }
        arrays = {name: _arrow(values, self.features[name]) for name, values in joined.items()}
        _write_table(pa.table(arrays), self.folder / layout.DATA_PATH.format(**numbers))
        rows = pa.Table.from_pylist(self.rows)
        _write_table(rows, self.folder / layout.EPISODES_PATH.format(**numbers))
        self.rows, self.columns = [], []

    def finish(self) -> None:
        """Write the last tables, and what describes the whole data set."""
        if self.count == 0:
            raise ValueError("episodes is empty: a data set has at least one")
        self._write_tables()
        statistics = {
            name: vector_statistics(np.concatenate(values)) for name, values in self.vectors.items()
        }
        for camera, counts in self.histograms.items():
            statistics[layout.CAMERA + camera] = picture_statistics(counts, self.frames)
        self._write_tasks()
        write_json_atomic(self.folder / layout.STATS_FILE, statistics)
        info = {
            "codebase_version": layout.VERSION,
            "robot_type": self.stage.robot,
            "total_episodes": self.count,
            "total_frames": self.frames,
            "total_tasks": 1,
            "chunks_size": layout.FILES_PER_CHUNK,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "fps": FPS,
            "splits": {"train": f"0:{self.count}"},
            "data_path": layout.DATA_PATH,
            "video_path": layout.VIDEO_PATH,
            "features": self.features,
        }
        write_json_atomic(self.folder / layout.INFO_FILE, info)

    def _write_tasks(self) -> None:
        """Write the table of tasks, whose index is the task in words."""
        import pandas as pd

        table = pd.DataFrame({"task_index": [0]}, index=[self.instruction])
        table.to_parquet(self.folder / layout.TASKS_FILE, engine="pyarrow")


def _arrow(values: NDArray[Any], feature: Mapping[str, Any]) -> Any:
    """Turn (frames, size) into a column: numbers if the size is 1, else lists of that size."""
    import pyarrow as pa

    kind = pa.from_numpy_dtype(np.dtype(feature["dtype"]))
    flat = pa.array(values.ravel(), type=kind)
    size = values.shape[1]
    return flat if size == 1 else pa.FixedSizeListArray.from_arrays(flat, size)


def _write_table(table: Any, path: Path) -> None:
    import pyarrow.parquet as pq

    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(table, path)
