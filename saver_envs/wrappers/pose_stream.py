"""Poses at a limited rate and with latency, as on a robot."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from saver_envs.perception.skeleton import N_JOINTS

#: Parts of the observation that describe a person.
SHAPES: Final = {
    "pose_2d": (N_JOINTS, 2),
    "pose_3d": (N_JOINTS, 3),
    "pose_scores": (N_JOINTS,),
    "pose_scores_3d": (N_JOINTS,),
}


@dataclass(frozen=True)
class PoseReading:
    """One person, the most certain one, as observed.

    :param entries: by the names of :data:`SHAPES`: joints in pixels, joints in metres in the world
        frame, and confidences in [0, 1] of both; 0 where a joint was not found or has no depth.
    :param taken: when the picture was taken, seconds of the episode; minus infinity where there
        was none.
    """

    entries: dict[str, NDArray[np.float32]]
    taken: float = -math.inf

    @staticmethod
    def nothing(taken: float = -math.inf) -> PoseReading:
        """Return a reading without joints: before the first result, or of an empty picture."""
        return PoseReading({name: np.zeros(s, np.float32) for name, s in SHAPES.items()}, taken)


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
