"""Record the data sets of chapter 7 with the twins, and read and write data files.

A data set is recorded once per seed, in a minute or two, and kept in the user's cache folder. A
file is plain NumPy (``.npz``, nothing pickled) with the columns of `COLUMNS`, each of shape
 (trajectories, samples, size); :func:`load_recordings` also reads such files of a real arm.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from saver_envs.files import cache_folder, written_whole
from saver_envs.modelling.arms import Task, arm_named, arms_with_twins
from saver_envs.modelling.arms.description import Campaign
from saver_envs.modelling.chain import Chain, FloatArray
from saver_envs.modelling.trajectories import random_trajectory
from saver_envs.modelling.twin import TIME_STEP, Record, Twin, nominal_inverse_dynamics

#: Increased whenever the same seed gives other samples.
VERSION = 1


#: Columns of a data file: fields of :class:`Recording`.
COLUMNS = ("position", "velocity", "acceleration", "torque", "hand")
#: Passes of the moving average. Position is differentiated twice, with a pass before each time; all
#: quantities get the same number of passes, so that torque and motion stay aligned.
_PASSES = 3


@dataclass(frozen=True)
class Recording:
    """Samples of one trajectory, in temporal order.

    :param position: (k, dof) joints, radians; metres for a lift.
    :param velocity: (k, dof), per second.
    :param acceleration: (k, dof), per second squared.
    :param torque: (k, dof), N m; N for a lift.
    :param hand: (k, 3) the end effector in the base frame, metres.
    """

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray
    hand: FloatArray

    def __len__(self) -> int:
        return len(self.position)

    def first(self, count: int) -> Recording:
        """Return the first ``count`` samples.

        :param count: number of samples.
        :raises ValueError: if there are fewer.
        """
        if not 0 < count <= len(self):
            raise ValueError(f"count={count!r}: must be 1 to {len(self)}")
        return Recording(*(getattr(self, name)[:count] for name in COLUMNS))

    @classmethod
    def joined(cls, parts: list[Recording]) -> Recording:
        """Return trajectories concatenated in time."""
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in COLUMNS))


@dataclass(frozen=True)
class DataSet:
    """An arm's samples.

    :param train: the training trajectories, concatenated.
    :param test: the held-out trajectory.
    """

    train: Recording
    test: Recording


def samples_of(recording: Recording, task: Task) -> tuple[FloatArray, FloatArray]:
    """Return inputs and outputs of a task (Section 7.3.1), in temporal order.

    :param recording: the samples.
    :param task: ``ik``: the end effector's position (n, 3) to joints (n, dof); ``id``: joints,
        their velocities and accelerations (n, 3 dof) to torques (n, dof).
    """
    if task == "ik":
        return recording.hand, recording.position
    motion = (recording.position, recording.velocity, recording.acceleration)
    return np.concatenate(motion, axis=1), recording.torque


def twin_data_set(
    name: str, seed: int = 0, progress: Callable[[int], None] | None = None
) -> DataSet:
    """Return an arm's data set, from the cache if it is there.

    :param name: the arm's name.
    :param seed: of the way-points and the sensors' noise.
    :param progress: called with the number of simulation steps since the previous call.
    :raises ValueError: for an arm without a twin.
    """
    campaign = campaign_of(name)
    path = cache_folder("modelling") / f"{name}-seed{seed}-v{VERSION}.npz"
    if not path.exists():
        save_recordings(path, name, record_twin(name, campaign, seed, progress))
    recordings = load_recordings(path, name)
    return DataSet(Recording.joined(recordings[:-1]), recordings[-1])


def campaign_of(name: str) -> Campaign:
    """Return how data are recorded with an arm.

    :param name: the arm's name.
    :raises ValueError: for an arm without a twin.
    """
    campaign = arm_named(name).campaign
    if campaign is None:
        raise ValueError(f"robot={name!r}: there are data sets of {', '.join(arms_with_twins())}")
    return campaign


def simulated_steps(name: str) -> int:
    """Return the number of simulation steps that recording an arm's data set takes."""
    campaign = campaign_of(name)
    return round(campaign.way_points * campaign.interval / TIME_STEP)


def record_twin(
    name: str, campaign: Campaign, seed: int, progress: Callable[[int], None] | None = None
) -> list[Recording]:
    """Drive a twin along random trajectories and return a recording of each.

    The low-level controller's feed-forward uses the maker's inertia.

    :param name: the arm's name.
    :param campaign: trajectories to drive and samples to keep.
    :param seed: of way-points and noise; each trajectory has its own generator.
    :param progress: see :func:`twin_data_set`.
    """
    way_points, noise = np.random.SeedSequence(seed).spawn(2)
    trajectories = [
        random_trajectory(
            name, campaign.way_points, campaign.interval, np.random.default_rng(source)
        )
        for source in way_points.spawn(campaign.trajectories)
    ]
    record = Twin(name).track(
        trajectories,
        nominal_inverse_dynamics(name),
        np.random.default_rng(noise),
        campaign.log_every,
        progress,
    )
    return process(record, arm_named(name).chain, campaign)


def save_recordings(path: Path, name: str, recordings: list[Recording]) -> None:
    """Write a data file atomically.

    :param path: ends in ``.npz``.
    :param name: the arm's name.
    :param recordings: one per trajectory, of equal length.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    columns = {column: np.stack([getattr(one, column) for one in recordings]) for column in COLUMNS}
    content: dict[str, Any] = {"robot": np.array(name), **columns}
    with written_whole(path) as file:
        np.savez(file, **content)


def load_recordings(path: Path, name: str) -> list[Recording]:
    """Read and validate a data file.

    :param path: of an ``.npz`` file with the columns of `COLUMNS`, each (trajectories,
        samples, size).
    :param name: the arm that it must belong to.
    :raises ValueError: for an incomplete file or another format, missing columns, another arm's
        joints, mismatched shapes, or values that are not finite; the message says which.
    """
    dof = arm_named(name).dof
    try:
        with np.load(path, allow_pickle=False) as file:
            content = {column: file[column] for column in file.files}
    except (OSError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"{path} is not a complete data file: {error}") from error
    except ValueError as error:  # NumPy mistakes unknown formats for pickles
        raise ValueError(f"{path} is not a complete data file: not an .npz of numbers") from error
    missing = [column for column in COLUMNS if column not in content]
    if missing:
        raise ValueError(f"{path} lacks the columns {', '.join(missing)}")
    robot = str(content.get("robot", name))
    if robot != name:
        raise ValueError(f"{path} is of robot {robot!r}, not {name!r}")
    shape = content["position"].shape
    for column in COLUMNS:
        values, wanted = content[column], 3 if column == "hand" else dof
        if values.ndim != 3 or values.shape[-1] != wanted:
            needed = f"{name} needs (trajectories, samples, {wanted})"
            raise ValueError(f"{path}: {column} has shape {values.shape}; {needed}")
        if values.shape[:2] != shape[:2]:
            counts = f"{values.shape[:2]} samples, position {shape[:2]}"
            raise ValueError(f"{path}: {column} has {counts}")
        if not np.isfinite(values).all():
            where = np.argwhere(~np.isfinite(values))[0].tolist()
            raise ValueError(f"{path}: {column}{where} is not finite")
    return [
        Recording(*(content[column][index].astype(np.float64) for column in COLUMNS))
        for index in range(shape[0])
    ]


def process(record: Record, chain: Chain, campaign: Campaign) -> list[Recording]:
    """Return a recording for each arm of a log.

    The end effector's position is that of the arm's own forward model, as in the paper.

    :param record: log of n arms.
    :param chain: gives the end effector.
    :param campaign: gives the log's rate, cuts and window.
    """
    step, window = TIME_STEP * campaign.log_every, campaign.window
    cut = round(campaign.cut / step)
    keep = slice(cut, record.position.shape[1] - cut, campaign.keep_every)
    recordings = []
    for position, torque in zip(record.measured_position, record.measured_torque, strict=True):
        motion = [position]
        for _ in range(2):
            motion.append(np.gradient(smoothed(motion[-1], window), step, axis=0))
        # The acceleration lacks one pass, the velocity two, the position all of them.
        position, velocity, acceleration = (
            smoothed(one, window, _PASSES - order)[keep] for order, one in enumerate(motion)
        )
        torque = smoothed(torque, window, _PASSES)[keep]
        hand = chain.position(position)
        recordings.append(Recording(position, velocity, acceleration, torque, hand))
    return recordings


def smoothed(values: FloatArray, window: int, passes: int = 1) -> FloatArray:
    """Return the centred moving average; beyond the ends the outermost values are repeated.

    :param values: (k, ...).
    :param window: length in samples; an even window weights its two outermost samples by half.
    :param passes: number of times that it is applied.
    """
    half = window // 2
    span = 2 * half + 1
    for _ in range(passes):
        padded = np.concatenate([values[:1]] * half + [values] + [values[-1:]] * half)
        total = np.cumsum(padded, axis=0)
        total = np.concatenate([np.zeros_like(total[:1]), total])
        inner = total[span:] - total[:-span]
        if window % 2 == 0:
            inner -= 0.5 * (padded[: len(values)] + padded[span - 1 :])
        values = inner / window
    return values
