"""The data sets of chapter 7: six trajectories of the MICO, two of the Fetch, from the twins.

They are made once for a seed, in a minute or two, and kept in the user's cache folder. A file is
plain NumPy (``.npz``, nothing pickled) with the columns of `recordings.COLUMNS`, each of shape
(trajectories, samples, numbers); files of one's own arm in that form are read by the same loader.
"""

from __future__ import annotations

import os
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from saver_envs.files import written_whole
from saver_envs.modelling.arms import Task, arm_named
from saver_envs.modelling.chain import FloatArray
from saver_envs.modelling.recordings import COLUMNS, Processing, Recording, process
from saver_envs.modelling.trajectories import random_trajectory
from saver_envs.modelling.twin import TIME_STEP, Twin, nominal_inverse_dynamics

#: Raised whenever the same seed would give other samples.
VERSION = 1


@dataclass(frozen=True)
class Campaign:
    """How an arm is made to move and what is kept of it (Section 7.3.5).

    :param trajectories: all but the last are for training, the last for testing.
    :param way_points: cubics of a trajectory.
    :param interval: duration of a cubic, seconds.
    :param log_every: simulation steps between logged samples.
    :param processing: cuts, smoothing and thinning.
    :param samples: of a trajectory.
    """

    trajectories: int
    way_points: int
    interval: float
    log_every: int
    processing: Processing
    samples: int


CAMPAIGNS = {
    # 800 s, a way-point every 8 s, logged at 500 Hz; two way-points are cut at either end and one
    # sample in 32 is kept.
    "mico": Campaign(6, 100, 8.0, 1, Processing(16.0, 50, 32), 12_000),
    # 2,400 s between the cuts, a way-point every 4 s, logged at 100 Hz. The window spans the same
    # 0.1 s as the MICO's.
    "fetch": Campaign(2, 602, 4.0, 5, Processing(4.0, 10, 4), 60_000),
}


@dataclass(frozen=True)
class DataSet:
    """An arm's samples.

    :param robot: the arm's name.
    :param train: the training trajectories, one behind the other.
    :param test: the trajectory that no model has seen.
    """

    robot: str
    train: Recording
    test: Recording


def samples_of(recording: Recording, task: Task) -> tuple[FloatArray, FloatArray]:
    """Return inputs and outputs of a task (Section 7.3.1), in the order of time.

    :param recording: the samples.
    :param task: ``ik``: the end effector's position (n, 3) to joints (n, dof); ``id``: joints,
        their velocities and accelerations (n, 3 dof) to torques (n, dof).
    """
    if task == "ik":
        return recording.hand, recording.position
    motion = (recording.position, recording.velocity, recording.acceleration)
    return np.concatenate(motion, axis=1), recording.torque


def default_cache() -> Path:
    """Where data sets are kept: in the user's cache folder."""
    root = os.environ.get("XDG_CACHE_HOME")
    return (Path(root) if root else Path.home() / ".cache") / "saver-envs" / "modelling"


def twin_data_set(
    name: str,
    seed: int = 0,
    cache: Path | None = None,
    progress: Callable[[int], None] | None = None,
) -> DataSet:
    """Return an arm's data set, from the cache if it is there.

    :param name: ``mico`` or ``fetch``.
    :param seed: of the way-points and the sensors' noise.
    :param cache: folder of the files; the user's cache folder by default.
    :param progress: is told the number of simulation steps done since it was last told.
    :raises ValueError: for another arm.
    """
    campaign = campaign_of(name)
    path = (cache or default_cache()) / f"{name}-seed{seed}-v{VERSION}.npz"
    if not path.exists():
        recordings = record_twin(name, campaign, seed, progress)
        save_recordings(path, name, recordings)
    recordings = load_recordings(path, name)
    return DataSet(name, Recording.joined(recordings[:-1]), recordings[-1])


def campaign_of(name: str) -> Campaign:
    """Return an arm's campaign.

    :raises ValueError: for an arm without one.
    """
    if name not in CAMPAIGNS:
        raise ValueError(f"robot={name!r}: there are data sets of {', '.join(CAMPAIGNS)}")
    return CAMPAIGNS[name]


def simulated_steps(name: str) -> int:
    """Return the number of steps that making an arm's data set takes."""
    campaign = campaign_of(name)
    return round(campaign.way_points * campaign.interval / TIME_STEP)


def record_twin(
    name: str, campaign: Campaign, seed: int, progress: Callable[[int], None] | None = None
) -> list[Recording]:
    """Drive a twin through random trajectories and return what was recorded of each.

    The low-level controller knows the maker's inertia.

    :param name: ``mico`` or ``fetch``.
    :param campaign: what is driven and kept.
    :param seed: of way-points and noise; each trajectory has a source of randomness of its own.
    :param progress: see :func:`twin_data_set`.
    """
    ways, noise = np.random.SeedSequence(seed).spawn(2)
    trajectories = [
        random_trajectory(
            name, campaign.way_points, campaign.interval, np.random.default_rng(source)
        )
        for source in ways.spawn(campaign.trajectories)
    ]
    record = Twin(name).track(
        trajectories,
        nominal_inverse_dynamics(name),
        np.random.default_rng(noise),
        campaign.log_every,
        progress,
    )
    recordings = process(record, arm_named(name).chain, campaign.processing)
    for recording in recordings:
        if len(recording) != campaign.samples:
            raise ValueError(f"{name}: {len(recording)} samples instead of {campaign.samples}")
    return recordings


def save_recordings(path: Path, name: str, recordings: list[Recording]) -> None:
    """Write a data file, as a whole or not at all.

    :param path: ends in ``.npz``.
    :param name: the arm's name.
    :param recordings: of equal length.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    columns = {column: np.stack([getattr(one, column) for one in recordings]) for column in COLUMNS}
    content: dict[str, Any] = {"robot": np.array(name), **columns}
    with written_whole(path) as file:
        np.savez(file, **content)


def load_recordings(path: Path, name: str) -> list[Recording]:
    """Read a data file and check it.

    :param path: of an ``.npz`` file with the columns of `recordings.COLUMNS`, each (trajectories,
        samples, numbers).
    :param name: the arm that it must be of.
    :raises ValueError: for a file that is cut short or not ours, for missing columns, another
        arm's joints, shapes that differ, or values that are not finite; the message says which.
    """
    dof = arm_named(name).dof
    try:
        with np.load(path, allow_pickle=False) as file:
            content = {column: file[column] for column in file.files}
    except (OSError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"{path} is no complete data file: {error}") from error
    except ValueError as error:  # NumPy takes what it does not know for a pickle, and says how to
        raise ValueError(f"{path} is no complete data file: it is no .npz of numbers") from error
    missing = [column for column in COLUMNS if column not in content]
    if missing:
        raise ValueError(f"{path} lacks the columns {', '.join(missing)}")
    robot = str(content.get("robot", name))
    if robot != name:
        raise ValueError(f"{path} is of robot {robot!r}, not {name!r}")
    shape = content["position"].shape
    for column, numbers in COLUMNS.items():
        values, wanted = content[column], dof if numbers == "dof" else 3
        if values.ndim != 3 or values.shape[-1] != wanted:
            raise ValueError(
                f"{path}: {column} has shape {values.shape}; {name} needs (trajectories, samples, "
                f"{wanted})"
            )
        if values.shape[:2] != shape[:2]:
            raise ValueError(
                f"{path}: {column} has {values.shape[:2]} samples, position {shape[:2]}"
            )
        if not np.isfinite(values).all():
            where = np.argwhere(~np.isfinite(values))[0].tolist()
            raise ValueError(f"{path}: {column}{where} is not finite")
    return [
        Recording(*(content[column][index].astype(np.float64) for column in COLUMNS))
        for index in range(shape[0])
    ]
