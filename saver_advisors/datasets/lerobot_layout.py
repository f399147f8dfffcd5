"""The files of a LeRobot data set, version 3.0, and the features of ours.

LeRobot's documentation describes the layout: ``meta/info.json``, ``meta/stats.json``,
``meta/tasks.parquet``, episodes in ``meta/episodes``, steps in ``data`` and pictures in ``videos``.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from saver_advisors.datasets.recorded_episodes import RecordedEpisode
from saver_advisors.reporting.video import FPS
from saver_envs.tasks.contract import Task
from saver_envs.tasks.layout import Layout

VERSION: Final = "v3.0"
INFO_FILE: Final = "meta/info.json"
STATS_FILE: Final = "meta/stats.json"
TASKS_FILE: Final = "meta/tasks.parquet"
_NUMBERED: Final = "chunk-{chunk_index:03d}/file-{file_index:03d}"
EPISODES_PATH: Final = f"meta/episodes/{_NUMBERED}.parquet"
DATA_PATH: Final = f"data/{_NUMBERED}.parquet"
VIDEO_PATH: Final = f"videos/{{video_key}}/{_NUMBERED}.mp4"
FILES_PER_CHUNK: Final = 1000
EPISODES_PER_FILE: Final = 50
"""Keeps files well below LeRobot's limits of 100 MB (data) and 200 MB (videos)."""

STATE: Final = "observation.state"
GOAL: Final = "observation.environment_state"
CAMERA: Final = "observation.images."
INDICES: Final = ("timestamp", "frame_index", "episode_index", "index", "task_index")
"""Features that every data set has, one number each."""


def file_numbers(episode: int) -> dict[str, int]:
    """Return in which chunk and in which of its files an episode is.

    :param episode: index of the episode
    """
    number = episode // EPISODES_PER_FILE
    return {
        "chunk_index": number // FILES_PER_CHUNK,
        "file_index": number % FILES_PER_CHUNK,
    }


def features_of(
    task: Task, action_size: int, advised: bool, cameras: tuple[str, ...], size: tuple[int, int]
) -> dict[str, dict[str, Any]]:
    """Describe the features of a data set, as its ``info.json`` does.

    :param task: of the environment
    :param action_size: of an action
    :param advised: whether there is a teacher, and so the feature ``advised``
    :param cameras: names of the cameras
    :param size: width and height of the pictures, pixels
    :return: by name: type, shape and names of the numbers
    """
    commands = [f"arm{arm} {index}" for arm, index in _by_arm(task.n_arms, action_size)]
    features = {
        STATE: _feature("float32", names_of(task.observation_layout)),
        GOAL: _feature("float32", names_of(task.goal_layout)),
        "action": _feature("float32", commands),
        "next.reward": _feature("float32"),
        "next.done": _feature("bool"),
        "next.success": _feature("bool"),
    }
    if advised:
        features["advised"] = _feature("bool", [f"arm{arm}" for arm in range(task.n_arms)])
    for name in INDICES:
        features[name] = _feature("float32" if name == "timestamp" else "int64")
    width, height = size
    for camera in cameras:
        features[CAMERA + camera] = {
            "dtype": "video",
            "shape": [height, width, 3],
            "names": ["height", "width", "channels"],
            "info": {
                "video.height": height,
                "video.width": width,
                "video.codec": "h264",
                "video.pix_fmt": "yuv420p",
                "video.is_depth_map": False,
                "video.fps": FPS,
                "video.channels": 3,
                "has_audio": False,
            },
        }
    return features


def _feature(dtype: str, names: list[str] | None = None) -> dict[str, Any]:
    return {"dtype": dtype, "shape": [len(names or "1")], "names": names}


def _by_arm(n_arms: int, size: int) -> list[tuple[int, int]]:
    """Return arm and index within its block of each number of a vector."""
    return [divmod(index, size // n_arms) for index in range(size)]


def names_of(layout: Layout) -> list[str]:
    """Name each number of a vector, such as ``arm0 object position 2``.

    :param layout: of the vector
    """
    own = [part for part in layout.parts if not part.shared]
    shared = [part for part in layout.parts if part.shared]
    names = [
        f"arm{arm} {part.name} {index}"
        for arm in range(layout.n_arms)
        for part in own
        for index in range(part.size)
    ]
    return names + [f"{part.name} {index}" for part in shared for index in range(part.size)]


def columns_of(
    episode: RecordedEpisode, number: int, first_frame: int, advised: bool
) -> dict[str, NDArray[Any]]:
    """Return the features of an episode's T steps, without pictures.

    The observation after the last action is not part of a LeRobot data set.

    :param episode: the episode
    :param number: its index in the data set
    :param first_frame: index in the data set of its first step
    :param advised: whether there is the feature ``advised``
    :return: (T, size) each
    """
    steps = np.arange(len(episode))
    done = episode.terminations | episode.truncations
    columns: dict[str, NDArray[Any]] = {
        STATE: episode.observations["observation"][:-1],
        GOAL: episode.observations["desired_goal"][:-1],
        "action": episode.actions,
        "next.reward": episode.rewards[:, None],
        "next.done": done[:, None],
        "next.success": np.asarray(episode.infos["is_success"][1:], bool)[:, None],
    }
    if advised:
        columns["advised"] = np.asarray(episode.infos["advised"][1:], bool)
    indices: dict[str, NDArray[Any]] = {
        "timestamp": (steps / FPS).astype(np.float32),
        "frame_index": steps,
        "episode_index": np.full(len(steps), number),
        "index": first_frame + steps,
        "task_index": np.zeros(len(steps), np.int64),
    }
    return columns | {name: values[:, None] for name, values in indices.items()}
