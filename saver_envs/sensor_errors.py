"""Errors of the sensors: Gaussian ones at every step, and an offset that an episode keeps.

Only ``observation`` is disturbed. The achieved goal stays exact, because rewards are computed from
it: otherwise relabelling would give other rewards than the environment.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saver_envs.control import length
from saver_envs.tasks.arm_and_object import ORIENTATION
from saver_envs.tasks.layout import Layout

Array = NDArray[np.float64]

#: Of a person's limbs, which the camera locates as it does objects.
_JOINTS = ("ankle", "knee", "wrist", "elbow")
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
    Sensor(ORIENTATION, 0.03),
    Sensor("object linear velocity", 0.03),
    Sensor("object angular velocity", 0.3),
    *(Sensor(f"{joint} position", 0.003, offset=0.005) for joint in _JOINTS),
    *(Sensor(f"{joint} velocity", 0.03) for joint in _JOINTS),
    Sensor("load position on the object", 0.003, offset=0.005),
    Sensor("load velocity on the object", 0.03),
)


#: Of the sequence of PCG64, an odd number; NumPy draws it from the seed.
_INCREMENT = np.random.PCG64(0).state["state"]["inc"]
#: Actions whose errors are drawn at once.
_BLOCK = 25
#: The Hamilton product of half a rotation vector and a quaternion, as a matrix that is multiplied
#: with the vector: the quaternion's entries in it, and their factors.
_FACTORS = np.array([[1, 2, 3], [0, 3, 2], [3, 0, 1], [2, 1, 0]])
_HALVES = np.array([[-1, -1, -1], [1, 1, -1], [-1, 1, 1], [1, -1, 1]]) / 2


class SensorErrors:
    """The errors of n episodes, each with its own random generator.

    :param n: number of episodes.
    :param layout: of the observation; its parts that no sensor measures stay exact.
    :param moving_fingers: whether the fingers are measured.
    """

    def __init__(self, n: int, layout: Layout, moving_fingers: bool) -> None:
        # In the units of the observation. Numbers are drawn arm by arm and sensor by sensor, then
        # for what the arms share. The last one is an error of 0, that of everything exact.
        source: dict[str, NDArray[np.intp]] = {}
        deviation: list[Array] = []
        offset: list[Array] = []
        size = 0
        for shared, copies in ((False, (layout.n_arms,)), (True, ())):
            names = {part.name for part in layout.parts if part.shared == shared}
            sensors = [
                one
                for one in SENSORS
                if one.part in names and (moving_fingers or "finger" not in one.part)
            ]
            shape = *copies, len(sensors), 3
            drawn = size + np.arange(math.prod(shape)).reshape(shape)
            source |= {one.part: drawn[..., index, :] for index, one in enumerate(sensors)}
            scale = np.array([layout.part(one.part).scale for one in sensors])
            for values, kind in ((deviation, "deviation"), (offset, "offset")):
                of_sensors = scale * np.array([getattr(one, kind) for one in sensors])
                values.append(np.broadcast_to(of_sensors[:, None], shape).ravel())
            size += drawn.size
        self._deviation = np.append(np.concatenate(deviation), 0.0)
        self._offset_deviation = np.append(np.concatenate(offset), 0.0)
        size = self._deviation.size
        self._layout, self._rotation = layout, source.pop(ORIENTATION, None)
        # Entry of the observation -> number that is added, and number that is subtracted.
        self._added, self._subtracted = np.full((2, layout.size), size - 1)
        for name, numbers in source.items():
            layout.get(self._added, name)[...] = numbers
        if any(part.name == _RELATIVE for part in layout.parts):
            layout.get(self._added, _RELATIVE)[...] = source["object position"]
            layout.get(self._subtracted, _RELATIVE)[...] = source["gripper position"]
        self._generators = [np.random.Generator(np.random.PCG64()) for _ in range(n)]
        self._offset = np.zeros((n, size))
        # Errors of a block of actions, and how many of these actions have passed.
        self._noise = np.zeros((n, _BLOCK, layout.size))
        turned = () if self._rotation is None else self._rotation.shape
        self._turns = np.zeros((n, _BLOCK, *turned))
        self._passed = np.full(n, _BLOCK)

    def begin(self, row: int, generator: np.random.Generator) -> None:
        """Start the errors of an episode.

        :param row: which episode.
        :param generator: the episode's source of randomness; some of its numbers are used.
        """
        own = self._generators[row]
        high, low = generator.bit_generator.random_raw(2).tolist()
        # A random place in the one long sequence of numbers: a new generator takes longer.
        own.bit_generator.state = {
            **{"bit_generator": "PCG64", "has_uint32": 0, "uinteger": 0},
            "state": {"state": (high << 64) | low, "inc": _INCREMENT},
        }
        self._passed[row] = _BLOCK
        self._offset[row] = self._offset_deviation * own.standard_normal(self._deviation.size)

    def disturb(self, exact: Array, rows: NDArray[np.intp], factor: Array) -> Array:
        """Return observations as the sensors measure them.

        :param exact: (k, observation size); not modified.
        :param rows: (k,) whose they are.
        :param factor: (k, 1) of the errors.
        :return: (k, observation size). The object relative to the gripper is the difference of the
            two positions as they were measured.
        """
        passed = self._passed[rows]
        if (over := passed == _BLOCK).any():
            self._draw(rows[over], factor[over])
            passed[over] = 0
        self._passed[rows] = passed + 1
        seen: Array = exact + self._noise[rows, passed]
        if self._rotation is not None:
            part = self._layout.get(seen, ORIENTATION)  # a view
            part[...] = _turned(part, self._turns[rows, passed])
        return seen

    def _draw(self, rows: NDArray[np.intp], factor: Array) -> None:
        """Draw the errors of the next block of actions in episodes ``rows``."""
        errors = np.empty((len(rows), _BLOCK, self._deviation.size))
        for index, row in enumerate(rows.tolist()):
            self._generators[row].standard_normal(out=errors[index])
        errors *= self._deviation
        errors += self._offset[rows, None]
        errors *= factor[:, None]
        self._noise[rows] = errors.take(self._added, 2) - errors.take(self._subtracted, 2)
        if self._rotation is not None:
            self._turns[rows] = errors.take(self._rotation, 2)


def _turned(quaternion: Array, rotation: Array) -> Array:
    """Turn (..., 4) unit quaternions with w >= 0 by small (..., 3) rotation vectors, radians."""
    factors = quaternion.take(_FACTORS, -1) * _HALVES
    turned: Array = quaternion + np.matmul(factors, rotation[..., None])[..., 0]
    turned /= length(turned)[..., None]
    np.negative(turned, out=turned, where=turned[..., :1] < 0)
    return turned
