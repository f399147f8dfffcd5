"""From a controlled run to the samples that models learn from: cut, smooth, differentiate, thin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from saver_envs.modelling.chain import Chain, FloatArray
from saver_envs.modelling.twin import Record

#: Columns of a data file, with the numbers of each: of joints, or of a point.
COLUMNS = {
    "position": "dof",
    "velocity": "dof",
    "acceleration": "dof",
    "torque": "dof",
    "hand": "3",
}
#: Times that the moving average is applied: position is differentiated twice, and every quantity
#: must have been smoothed alike for torque and motion to belong together.
_PASSES = 3


@dataclass(frozen=True)
class Recording:
    """Samples of one trajectory, in the order of time.

    :param position: (k, dof) joints, radians; metres of a lift.
    :param velocity: (k, dof), per second.
    :param acceleration: (k, dof), per second squared.
    :param torque: (k, dof), N m; N of a lift.
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

        :raises ValueError: when there are fewer.
        """
        if not 0 < count <= len(self):
            raise ValueError(f"count={count!r}: must be 1 to {len(self)}")
        return Recording(*(getattr(self, name)[:count] for name in COLUMNS))

    @classmethod
    def joined(cls, parts: list[Recording]) -> Recording:
        """Return trajectories one behind the other."""
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in COLUMNS))


@dataclass(frozen=True)
class Processing:
    """How a run is made into samples.

    :param cut: seconds cut off at either end.
    :param window: samples of the moving average, at the run's rate.
    :param keep_every: of the smoothed samples one in so many is kept.
    """

    cut: float
    window: int
    keep_every: int


def process(record: Record, chain: Chain, processing: Processing) -> list[Recording]:
    """Make samples of a run: one recording for each of its arms.

    The end effector is where the arm's own forward model has it, as in the paper.

    :param record: of n arms.
    :param chain: gives the end effector.
    :param processing: cuts, window and rate.
    """
    step = float(record.time[1] - record.time[0])
    cut = round(processing.cut / step)
    keep = slice(cut, len(record.time) - cut, processing.keep_every)
    recordings = []
    for position, torque in zip(record.measured_position, record.measured_torque, strict=True):
        motion = [position]
        for _ in range(2):
            motion.append(np.gradient(smoothed(motion[-1], processing.window), step, axis=0))
        # One pass is still missing for the acceleration, two for the velocity, all for the rest.
        position, velocity, acceleration = (
            smoothed(one, processing.window, _PASSES - order)[keep]
            for order, one in enumerate(motion)
        )
        torque = smoothed(torque, processing.window, _PASSES)[keep]
        hand = chain.position(position)
        recordings.append(Recording(position, velocity, acceleration, torque, hand))
    return recordings


def smoothed(values: FloatArray, window: int, passes: int = 1) -> FloatArray:
    """Return the moving average over a window, centred.

    At the ends, where the window reaches beyond the data, the outermost values are repeated.

    :param values: (k, ...).
    :param window: samples; an even window weighs its two outermost samples by half.
    :param passes: how often it is applied.
    """
    half = window // 2
    for _ in range(passes):
        padded = np.concatenate(
            [np.repeat(values[:1], half, 0), values, np.repeat(values[-1:], half, 0)]
        )
        total = np.cumsum(padded, axis=0)
        total = np.concatenate([np.zeros_like(total[:1]), total])
        span = 2 * half + 1
        inner = total[span:] - total[:-span]
        if window % 2 == 0:
            inner -= 0.5 * (padded[: len(values)] + padded[span - 1 :])
        values = inner / window
    return values
