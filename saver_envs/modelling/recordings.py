"""Samples from a twin's log: cut, smoothed, differentiated and thinned."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from saver_envs.modelling.arms.description import Campaign
from saver_envs.modelling.chain import Chain, FloatArray
from saver_envs.modelling.twin import TIME_STEP, Record

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
