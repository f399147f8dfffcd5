"""Poses at a limited rate and with latency, as on a robot."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saver_envs.perception.skeleton import N_JOINTS


@dataclass(frozen=True)
class PoseReading:
    """One person, the most certain one, as observed.

    :param joints_2d: (14, 2) pixels; 0 where a joint was not found.
    :param joints_3d: (14, 3) metres, world frame; 0 where unknown.
    :param scores_2d: (14,) confidence in [0, 1]; 0 where a joint was not found.
    :param scores_3d: (14,) the same, 0 also where there is no depth at the joint.
    :param taken: when the picture was taken, seconds of the episode; minus infinity where there
        was none.
    """

    joints_2d: NDArray[np.float32]
    joints_3d: NDArray[np.float32]
    scores_2d: NDArray[np.float32]
    scores_3d: NDArray[np.float32]
    taken: float = -math.inf

    @staticmethod
    def nothing(taken: float = -math.inf) -> PoseReading:
        """Return a reading without joints: before the first result, or of an empty picture."""
        empty = np.zeros(N_JOINTS, dtype=np.float32)
        flat = np.zeros((N_JOINTS, 2), dtype=np.float32)
        space = np.zeros((N_JOINTS, 3), dtype=np.float32)
        return PoseReading(flat, space, empty, empty.copy(), taken)


class PoseStream:
    """Takes pictures at a rate and returns each result after a latency.

    :param rate: pictures per second.
    :param latency: seconds from a picture to its result. Pictures may be taken meanwhile, as by a
        camera with a pipeline behind it.
    """

    def __init__(self, rate: float, latency: float) -> None:
        self._rate, self._latency = rate, latency
        self.reset()

    def reset(self) -> None:
        """Begin an episode at time 0."""
        self._taken = 0
        self._waiting: deque[PoseReading] = deque()
        self._latest = PoseReading.nothing()

    def read(self, time: float, look: Callable[[float], PoseReading]) -> PoseReading:
        """Return the newest result available at a time.

        :param time: seconds of the episode, not before the previous call's.
        :param look: takes a picture now and estimates the pose, whose ``taken`` is its argument.
        """
        tolerance = 1e-9
        if time + tolerance >= self._taken / self._rate:
            self._waiting.append(look(time))
            # Pictures that were due between two calls cannot be taken any more.
            self._taken = int((time + tolerance) * self._rate) + 1
        while self._waiting and self._waiting[0].taken + self._latency <= time + tolerance:
            self._latest = self._waiting.popleft()
        return self._latest
