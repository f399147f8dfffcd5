"""Rotations of body parts, as matrices whose columns are the turned axes."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

Rotation = NDArray[np.float64]


def about(axis: ArrayLike, angle: float) -> Rotation:
    """Return the rotation (3, 3) about a unit axis.

    :param axis: (3,).
    :param angle: radians.
    """
    x, y, z = np.asarray(axis, dtype=np.float64)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross)


def frame_of(first: NDArray[np.float64], second: NDArray[np.float64]) -> Rotation:
    """Return the axes (3, 3), in columns, of which x is along ``first`` and z is across both."""
    x = first / np.linalg.norm(first)
    z = np.cross(first, second)
    z /= np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z], axis=1)


def shortest_turn(first: NDArray[np.float64], second: NDArray[np.float64]) -> Rotation:
    """Return the rotation (3, 3) that takes the direction of ``first`` to that of ``second``."""
    axis = np.cross(first, second)
    length = float(np.linalg.norm(axis))
    return about(axis / length, math.atan2(length, float(first @ second)))


def quaternion_of(rotation: Rotation) -> NDArray[np.float64]:
    """Return the quaternion (4,), w first, of a rotation (3, 3)."""
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, rotation.ravel())
    return quaternion


def matrix_of(quaternion: NDArray[np.float64]) -> Rotation:
    """Return the rotation (3, 3) of a quaternion (4,), w first."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)
