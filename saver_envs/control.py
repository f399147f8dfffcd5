"""From Cartesian set-points to joint targets: the inverse kinematics seam and its default."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from saver_envs.robots.description import Robot
from saver_envs.simulation import ArmState

#: Squared damping of the least squares: small against the squared singular values of a Jaco away
#: from stretched-out postures (0.05 to 1), large enough to keep joint steps bounded near them.
DAMPING = 1e-3
#: Largest joint step of one solve, radians.
LARGEST_JOINT_STEP = 0.3
#: A joint counts as idle where its turning moves the tool by less than this (m/rad).
IDLE_LEVER = 1e-6


class InverseKinematics(Protocol):
    """Turns tool set-points into joint targets: the place where a learned model plugs in."""

    def __call__(
        self, state: ArmState, target: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return joint targets for tool positions.

        :param state: the arms' present state, leading dimensions (n, arms).
        :param target: (n, arms, 3) tool positions in each arm's base frame, metres. The hand is
            meant to point down at its fixed yaw, on arms that can hold it.
        :return: (n, arms, dof) joint angles, radians.
        """


def orientation_error(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the turn (..., 3), radians to first order, that makes ``rotation`` the identity.

    It is half the sum of the cross products of each axis with its target axis.
    """
    return 0.5 * np.stack(
        [
            rotation[..., 1, 2] - rotation[..., 2, 1],
            rotation[..., 2, 0] - rotation[..., 0, 2],
            rotation[..., 0, 1] - rotation[..., 1, 0],
        ],
        axis=-1,
    )


def least_squares_step(
    jacobian: NDArray[np.float64], error: NDArray[np.float64], damping: float = DAMPING
) -> NDArray[np.float64]:
    """Return the damped least squares joint step J^T (J J^T + damping I)^-1 error.

    :param jacobian: (..., rows, dof).
    :param error: (..., rows), metres and radians.
    :param damping: squared damping factor, above 0.
    :return: (..., dof), radians.
    """
    transposed = np.swapaxes(jacobian, -1, -2)
    gram = jacobian @ transposed
    gram[..., range(gram.shape[-1]), range(gram.shape[-1])] += damping
    return (transposed @ np.linalg.solve(gram, error[..., None]))[..., 0]


class DampedLeastSquares:
    """One damped least squares step from the present joints towards the set-point.

    Arms that can hold their orientation solve for position and orientation, others for the
    position alone; joints that do not move the tool then go back to their home angle, for nothing
    else would bring them back once a contact has turned them.

    :param robot: gives the joint limits and whether orientation is held.
    :param damping: squared damping factor.
    """

    def __init__(self, robot: Robot, damping: float = DAMPING) -> None:
        self._holds_orientation = robot.holds_orientation
        self._damping = damping
        self._lower = np.asarray(robot.joint_lower)
        self._upper = np.asarray(robot.joint_upper)
        self._home = np.asarray(robot.home)

    def __call__(
        self, state: ArmState, target: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return joint targets (n, arms, dof); see :class:`InverseKinematics`."""
        error = target - state.tool_position
        jacobian = state.jacobian
        if self._holds_orientation:
            error = np.concatenate([error, orientation_error(state.tool_rotation)], axis=-1)
        else:
            jacobian = jacobian[..., :3, :]
        step = least_squares_step(jacobian, error, self._damping)
        if not self._holds_orientation:
            idle = np.abs(jacobian).max(axis=-2) < IDLE_LEVER
            step = np.where(idle, self._home - state.joint_position, step)
        step = np.clip(step, -LARGEST_JOINT_STEP, LARGEST_JOINT_STEP)
        return np.clip(state.joint_position + step, self._lower, self._upper)


@dataclass(frozen=True)
class Workspace:
    """The box that set-points are clipped to, one row per arm, in each arm's base frame.

    :param lower: (arms, 3), metres.
    :param upper: (arms, 3), metres.
    """

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]

    def clip(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return points (..., arms, 3) moved into the box."""
        return np.clip(points, self.lower, self.upper)

    def contains(self, points: NDArray[np.float64], margin: float = 0.0) -> NDArray[np.bool_]:
        """Say which points (..., arms, 3) lie in the box, ``margin`` metres from its walls."""
        inside = (points >= self.lower + margin) & (points <= self.upper - margin)
        return inside.all(axis=-1)
