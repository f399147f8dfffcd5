"""Check the files of a LeRobot data set, version 3.0, against one another."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from saver_advisors.datasets import lerobot_layout as layout
from saver_envs.files import read_json


def check_lerobot(folder: Path) -> dict[str, Any]:
    """Read a data set as LeRobot does, and check that its files agree.

    Checked are the files that ``info.json`` names, the columns of both tables and their types, the
    indices, times and borders of episodes, the statistics, and size, rate and number of the
    pictures of every video.

    :param folder: of the data set
    :return: its ``info.json``
    :raises FileNotFoundError: if a file is missing
    :raises ValueError: for files that do not agree; the message names what differs
    """
    import pandas as pd

    info = read_json(folder / layout.INFO_FILE)
    _equal("codebase_version", info["codebase_version"], layout.VERSION)
    tasks = pd.read_parquet(folder / layout.TASKS_FILE)
    _equal("rows of tasks.parquet", len(tasks), info["total_tasks"])
    episodes = _table(folder, "meta/episodes")
    _equal("rows of meta/episodes", len(episodes), info["total_episodes"])
    _equal("splits", info["splits"], {"train": f"0:{len(episodes)}"})
    features = info["features"]
    vectors = {name: one for name, one in features.items() if one["dtype"] != "video"}
    frames = _table(folder, "data")
    _equal("rows of data", len(frames), info["total_frames"])
    _equal("columns of data", sorted(frames.columns), sorted(vectors))
    for name, feature in vectors.items():
        _check_column(name, frames[name], feature)
    _check_indices(frames, episodes, tasks, info["fps"])
    _check_statistics(read_json(folder / layout.STATS_FILE), frames, features)
    for name in sorted(set(features) - set(vectors)):
        _check_videos(folder, info, name, episodes)
    return dict(info)


def _equal(what: str, found: Any, wanted: Any) -> None:
    if found != wanted:
        raise ValueError(f"{what} is {found!r}, should be {wanted!r}")


def _table(folder: Path, under: str) -> Any:
    """Read all files of a table in their order."""
    import pandas as pd

    paths = sorted((folder / under).glob("chunk-*/file-*.parquet"))
    if not paths:
        raise FileNotFoundError(f"{folder / under} has no table")
    return pd.concat([pd.read_parquet(path) for path in paths], ignore_index=True)


def _check_column(name: str, column: Any, feature: Mapping[str, Any]) -> None:
    values = np.stack(column.to_numpy())
    size = feature["shape"][0]
    shape = (len(column),) if size == 1 else (len(column), size)
    _equal(f"shape of {name}", values.shape, shape)
    _equal(f"type of {name}", str(values.dtype), feature["dtype"])
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        raise ValueError(f"{name} has a value that is not finite")
    if feature["names"] is not None:
        _equal(f"number of names of {name}", len(feature["names"]), size)


def _check_indices(frames: Any, episodes: Any, tasks: Any, fps: int) -> None:
    _equal("indices of frames", frames["index"].tolist(), list(range(len(frames))))
    _equal("indices of episodes", episodes["episode_index"].tolist(), list(range(len(episodes))))
    borders = episodes["dataset_from_index"].tolist(), episodes["dataset_to_index"].tolist()
    _equal("borders of episodes", [0, *borders[1]], [*borders[0], len(frames)])
    for number, (first, last) in enumerate(zip(*borders, strict=True)):
        own = frames.iloc[first:last]
        _equal(f"length of episode {number}", int(episodes["length"][number]), len(own))
        _equal(f"episode_index of episode {number}", set(own["episode_index"]), {number})
        _equal(f"frame_index of episode {number}", list(own["frame_index"]), list(range(len(own))))
        times = np.arange(len(own)) / fps
        if not np.allclose(own["timestamp"], times, atol=1e-4):
            raise ValueError(f"timestamp of episode {number} is not frame_index / {fps}")
        words = [tasks.index[index] for index in sorted(set(own["task_index"]))]
        _equal(f"tasks of episode {number}", list(episodes["tasks"][number]), words)


def _check_statistics(
    statistics: Mapping[str, Any], frames: Any, features: Mapping[str, Any]
) -> None:
    _equal("features of stats.json", sorted(statistics), sorted(features))
    for name, values in statistics.items():
        _equal(f"count of {name}", values["count"], [len(frames)])
        if features[name]["dtype"] == "video":
            continue
        column = np.stack(frames[name].to_numpy()).reshape(len(frames), -1).astype(float)
        for key, found in (
            ("min", column.min(0)),
            ("max", column.max(0)),
            ("mean", column.mean(0)),
        ):
            if not np.allclose(values[key], found, atol=1e-5):
                raise ValueError(f"{key} of {name} in stats.json is not that of the data")


def _check_videos(folder: Path, info: Mapping[str, Any], name: str, episodes: Any) -> None:
    """Check the videos of a camera, and where the episodes are in them."""
    import imageio_ffmpeg

    height, width, _ = info["features"][name]["shape"]
    numbers = [f"videos/{name}/{which}" for which in ("chunk_index", "file_index")]
    for (chunk, file), own in episodes.groupby(numbers):
        path = folder / info["video_path"].format(
            video_key=name, chunk_index=int(chunk), file_index=int(file)
        )
        if not path.is_file():
            raise FileNotFoundError(f"{path} is missing")
        about = next(imageio_ffmpeg.read_frames(str(path)))
        _equal(f"size of {path}", about["size"], (width, height))
        _equal(f"rate of {path}", about["fps"], float(info["fps"]))
        counted, _ = imageio_ffmpeg.count_frames_and_secs(str(path))
        _equal(f"pictures in {path}", counted, int(own["length"].sum()))
        first = own[f"videos/{name}/from_timestamp"].tolist()
        last = own[f"videos/{name}/to_timestamp"].tolist()
        lengths = np.subtract(last, first) * info["fps"]
        if first[0] != 0 or not np.allclose(lengths, own["length"]):
            raise ValueError(f"the times of the episodes in {path} are not those of their pictures")
        if any(end != start for (_, end), (start, _) in pairwise(zip(first, last, strict=True))):
            raise ValueError(f"the episodes in {path} do not follow one another")
