"""Errors of the sensors: Gaussian ones at every step, and an offset that an episode keeps.

Only ``observation`` is disturbed. The achieved goal stays exact, because rewards are computed from
it: otherwise relabelling would give other rewards than the environment.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saver_envs.control import length
from saver_envs.simulation import multiply_quaternions
from saver_envs.tasks.layout import Layout

Array = NDArray[np.float64]

_ORIENTATION = "object orientation, a quaternion with w >= 0"
_RELATIVE = "object position relative to the gripper"


@dataclass(frozen=True)
class Sensor:
    """How large the errors of a part of the observation are, in SI units, equal for its axes.

    :param part: name of the part; an orientation is turned by its error, others are added to.
    :param deviation: standard deviation of the error of each step.
    :param offset: standard deviation of the error that an episode keeps.
    """

    part: str
    deviation: float
    offset: float = 0.0


#: Arm and fingers have encoders, so their position errors are small, and their velocity errors are
#: those of filtered differences. A depth camera 1.2 m above the table (Table 8.1) locates objects
#: with errors of some millimetres; its calibration error to the arm's base is constant within an
#: episode. Object velocities are differences of camera positions over a few frames. The values are
#: ours: the dissertation gives none.
SENSORS = (
    Sensor("gripper position", 0.001),
    Sensor("gripper linear velocity", 0.01),
    Sensor("finger positions", 0.01),
    Sensor("finger velocities", 0.05),
    Sensor("object position", 0.003, offset=0.005),
    Sensor(_ORIENTATION, 0.03),
    Sensor("object linear velocity", 0.03),
    Sensor("object angular velocity", 0.3),
)


class SensorErrors:
    """The errors of n episodes, each with its own random generator.

    :param n: number of episodes.
    :param layout: of the observation; its parts that no sensor measures stay exact.
    :param moving_fingers: whether the fingers are measured.
    """

    def __init__(self, n: int, layout: Layout, moving_fingers: bool) -> None:
        names = {part.name for part in layout.parts if not part.shared}
        self._layout = layout
        self._sensors = [
            one
            for one in SENSORS
            if one.part in names and (moving_fingers or "finger" not in one.part)
        ]
        # In the units of the observation, in the order in which they are drawn.
        scale = np.array([layout.part(one.part).scale for one in self._sensors])
        self._deviation = (scale * [one.deviation for one in self._sensors])[:, None]
        self._offset_deviation = (scale * [one.offset for one in self._sensors])[:, None]
        self._shape = layout.n_arms, len(self._sensors), 3
        self._generators = [np.random.default_rng() for _ in range(n)]
        self._offset = np.zeros((n, *self._shape))

    def begin(self, row: int, generator: np.random.Generator) -> None:
        """Start the errors of an episode.

        :param row: which episode.
        :param generator: the episode's source of randomness; one number of it is used.
        """
        own = np.random.default_rng(generator.integers(2**63))
        self._generators[row] = own
        self._offset[row] = self._offset_deviation * own.standard_normal(self._shape)

    def disturb(self, exact: Array, rows: NDArray[np.intp], factor: Array) -> Array:
        """Return observations as the sensors measure them.

        :param exact: (k, observation size); not modified.
        :param rows: (k,) whose they are.
        :param factor: (k, 1) of the errors; with 0 an episode's observations stay exact.
        :return: (k, observation size). The object relative to the gripper is the difference of the
            two positions as they were measured.
        """
        drawn = np.stack([self._generators[row].standard_normal(self._shape) for row in rows])
        errors = (drawn * self._deviation + self._offset[rows]) * factor[:, :, None, None]
        by_part = {one.part: errors[:, :, index] for index, one in enumerate(self._sensors)}
        layout, seen = self._layout, exact.copy()
        for name, error in by_part.items():
            part = layout.get(seen, name)  # a view
            part[...] = _turned(part, error) if name == _ORIENTATION else part + error
        if _RELATIVE in (part.name for part in layout.parts):
            apart = by_part["object position"] - by_part["gripper position"]
            layout.get(seen, _RELATIVE)[...] += apart
        return seen


def _turned(quaternion: Array, rotation: Array) -> Array:
    """Turn (..., 4) unit quaternions with w >= 0 by (..., 3) rotation vectors, radians."""
    half = length(rotation)[..., None] / 2
    # sin(a/2)/a without a division by zero; NumPy's sinc has a factor pi.
    small = np.concatenate([np.cos(half), rotation * np.sinc(half / np.pi) / 2], axis=-1)
    turned = multiply_quaternions(small, quaternion)
    turned /= length(turned)[..., None]
    return np.where(turned[..., :1] < 0, -turned, turned)
