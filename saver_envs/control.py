"""From Cartesian set-points to joint targets: the inverse kinematics interface and its default."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from saver_envs.robots.description import Robot
from saver_envs.simulation import ArmState
from saver_envs.validation import real_array

#: Squared damping of the least squares: small against the squared singular values of a Jaco away
#: from stretched-out postures (0.05 to 1), large enough to keep joint steps bounded near them.
DAMPING = 1e-3
#: Largest joint step of one solve, radians.
LARGEST_JOINT_STEP = 0.3
#: A joint is idle if turning it moves the tool by less than this (m/rad).
IDLE_LEVER = 1e-6


#: Flat indices of the entries of a rotation matrix whose differences give its rotation vector.
_ABOVE_DIAGONAL, _BELOW_DIAGONAL = np.array([5, 6, 1]), np.array([7, 2, 3])


def bounded(
    values: NDArray[np.float64],
    lower: NDArray[np.float64] | float,
    upper: NDArray[np.float64] | float,
) -> NDArray[np.float64]:
    """Return values between bounds, as ``numpy.clip`` does, at half its cost on few values."""
    return np.minimum(np.maximum(values, lower), upper)


def length(vectors: NDArray[np.floating]) -> NDArray[Any]:
    """Return lengths (...) of vectors (..., d); thrice as fast as NumPy's norm on few of them."""
    return np.sqrt((vectors * vectors).sum(axis=-1))


def shortened(vectors: NDArray[np.floating], longest: NDArray[np.floating] | float) -> NDArray[Any]:
    """Return vectors (..., 3), those longer than ``longest`` (..., 1) scaled down to it."""
    length = np.sqrt((vectors * vectors).sum(axis=-1, keepdims=True))
    return vectors * np.minimum(1.0, longest / np.maximum(length, 1e-12))


def checked_action(
    action: ArrayLike, shape: tuple[int, ...], name: str = "action"
) -> NDArray[np.float64]:
    """Return an action clipped to [-1, 1].

    :param action: of an agent.
    :param shape: that it must have.
    :param name: what the messages call it.
    :raises ValueError: for another shape, or a value that is not a finite real number.
    """
    values = real_array(name, action).astype(np.float64, copy=False)
    if values.shape != shape:
        raise ValueError(f"{name} of shape {values.shape}: must have shape {shape}")
    if not np.isfinite(values).all():
        raise ValueError(f"{name}={values!r}: every value must be finite")
    return bounded(values, -1.0, 1.0)


class InverseKinematics(Protocol):
    """Converts tool set-points to joint targets; a learned model can take its place."""

    def __call__(self, state: ArmState, target: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return joint targets for tool positions.

        :param state: the arms' present state, leading dimensions (n, arms).
        :param target: (n, arms, 3) tool positions in each arm's base frame, metres. The hand points
            down at its fixed yaw, on arms that can hold it.
        :return: (n, arms, dof) joint angles, radians.
        """


def orientation_error(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the turn (..., 3), radians to first order, that makes ``rotation`` the identity.

    It is half the sum of the cross products of each axis with its target axis.
    """
    entries = rotation.reshape(*rotation.shape[:-2], 9)
    return 0.5 * (entries.take(_ABOVE_DIAGONAL, -1) - entries.take(_BELOW_DIAGONAL, -1))


def tool_error(
    state: ArmState, target: NDArray[np.float64], holds_orientation: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the tools' errors and the rows of the Jacobian that correct them.

    :param state: the arms' state.
    :param target: (n, arms, 3) tool positions in base frames, metres.
    :param holds_orientation: whether the tools also keep the axes of the bases.
    :return: (n, arms, rows) metres and radians, and (n, arms, rows, dof); 6 rows, or 3 for the
        position alone.
    """
    error = target - state.tool_position
    if not holds_orientation:
        return error, state.jacobian[..., :3, :]
    turn = orientation_error(state.tool_rotation)
    return np.concatenate([error, turn], axis=-1), state.jacobian


def least_squares_step(
    jacobian: NDArray[np.float64], error: NDArray[np.float64], damping: float = DAMPING
) -> NDArray[np.float64]:
    """Return the damped least squares joint step J^T (J J^T + damping I)^-1 error.

    :param jacobian: (..., rows, dof).
    :param error: (..., rows), metres and radians.
    :param damping: squared damping factor, above 0.
    :return: (..., dof), radians.
    """
    transposed = jacobian.swapaxes(-1, -2)
    gram = jacobian @ transposed
    rows = gram.shape[-1]
    gram.reshape(*gram.shape[:-2], -1)[..., :: rows + 1] += damping  # the diagonal
    return (transposed @ np.linalg.solve(gram, error[..., None]))[..., 0]


class DampedLeastSquares:
    """One damped least squares step from the present joints towards the set-point.

    Arms that can hold their orientation solve for position and orientation, others for the position
    alone; joints that do not move the tool then return to their home angle: nothing else would undo
    a turn by a contact.

    :param robot: gives the joint limits and whether orientation is held.
    """

    def __init__(self, robot: Robot) -> None:
        self._holds_orientation = robot.holds_orientation
        self._lower = np.asarray(robot.joint_lower)
        self._upper = np.asarray(robot.joint_upper)
        self._home = np.asarray(robot.home)

    def __call__(self, state: ArmState, target: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return joint targets (n, arms, dof); see :class:`InverseKinematics`."""
        error, jacobian = tool_error(state, target, self._holds_orientation)
        step = least_squares_step(jacobian, error)
        if not self._holds_orientation:
            idle = np.abs(jacobian).max(axis=-2) < IDLE_LEVER
            step = np.where(idle, self._home - state.joint_position, step)
        step = bounded(step, -LARGEST_JOINT_STEP, LARGEST_JOINT_STEP)
        return bounded(state.joint_position + step, self._lower, self._upper)


@dataclass(frozen=True)
class Workspace:
    """The region of valid set-points in base frames: a box within reach of the shoulder.

    :param lower: (arms, 3) or (n, arms, 3), metres.
    :param upper: likewise.
    :param hand_reach: greatest distance from the shoulder, metres; infinity if only the box limits
        it.
    :param shoulder_height: height of the shoulder above the base, metres.
    """

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    hand_reach: float = math.inf
    shoulder_height: float = 0.0

    def raised(self, height: float) -> Workspace:
        """Return the same region whose lower side is this much higher, metres."""
        return replace(self, lower=self.lower + np.array([0.0, 0.0, height])) if height else self

    def clip(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return points (..., arms, 3) moved into the box, then level towards the base's axis."""
        boxed = bounded(points, self.lower, self.upper)
        if math.isfinite(self.hand_reach):
            longest = self._horizontal_reach(boxed[..., 2:])
            length = np.hypot(boxed[..., :1], boxed[..., 1:2])
            boxed[..., :2] *= np.minimum(1.0, longest / np.maximum(length, 1e-12))
        return boxed

    def contains(self, points: NDArray[np.float64], height: float = 0.0) -> NDArray[np.bool_]:
        """Return which points (..., arms, 3) lie inside the region :meth:`raised` by a height."""
        lower = self.lower.copy()
        lower[..., 2] += height
        inside = (points >= lower) & (points <= self.upper)
        within: NDArray[np.bool_] = np.logical_and.reduce(inside, axis=-1)
        if math.isfinite(self.hand_reach):
            length = np.hypot(points[..., 0], points[..., 1])
            within &= length <= self._horizontal_reach(points[..., 2])
        return within

    def _horizontal_reach(self, height: NDArray[np.float64]) -> NDArray[np.float64]:
        """Greatest distance from the base's axis at given heights, metres."""
        rise = height - self.shoulder_height
        return np.sqrt(np.maximum(self.hand_reach**2 - rise**2, 0.0))


#: Largest lead of a set-point over the tool, in displacements of an action at top speed (0.05 m at
#: 0.5 m/s): a blocked arm presses with bounded force, reverses at once, and does not overshoot when
#: it comes free.
LEAD_LIMIT = 2.5


@dataclass(frozen=True)
class SetPointRule:
    """How a Cartesian action moves the tools' set-points.

    :param workspace: where set-points may be.
    :param longest: displacement of a set-point in one action at top speed, metres; one number, or
        (n, 1, 1).
    :param held_height: of all set-points (m), or ``None`` where the action sets it; one number, or
        (n, 1).
    """

    workspace: Workspace
    longest: float | NDArray[np.float64]
    held_height: float | NDArray[np.float64] | None = None

    def unclipped(
        self,
        previous: NDArray[np.float64],
        motion: NDArray[np.float64],
        tool: NDArray[np.float64],
        freedom: NDArray[np.float64] | float = 1.0,
    ) -> NDArray[np.float64]:
        """Move set-points within top speed and lead limit, but not yet within the workspace.

        :param previous: (..., arms, 3) set-points so far, base frames, metres.
        :param motion: (..., arms, 3) in [-1, 1].
        :param tool: (..., arms, 3) where the tools are, base frames, metres.
        :param freedom: (..., arms, 1) fraction of the lead limit that is allowed.
        :return: (..., arms, 3), metres.
        """
        wanted = previous + shortened(motion * self.longest, self.longest)
        moved = tool + shortened(wanted - tool, LEAD_LIMIT * self.longest * freedom)
        if self.held_height is not None:
            moved[..., 2] = self.held_height
        return moved

    def moved(
        self,
        previous: NDArray[np.float64],
        motion: NDArray[np.float64],
        tool: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Move set-points within top speed, lead limit and workspace; see :meth:`unclipped`."""
        return self.workspace.clip(self.unclipped(previous, motion, tool))
