"""Points that an arm can reach with its hand as tasks hold it, and postures that reach them."""

from __future__ import annotations

from functools import lru_cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from saver_envs.control import LARGEST_JOINT_STEP, bounded, least_squares_step, length, tool_error
from saver_envs.robots.description import Fingers, Robot
from saver_envs.scenes import Arms, compose
from saver_envs.simulation import Simulation

#: Points of the grid over a robot's box of hand positions.
GRID_SHAPE = (8, 21, 8)
#: Where arms reach the lowest layer of the grid, they also reach this far below it (m).
BELOW_GRID = 0.015
#: A point counts as reached within these residuals (m, rad).
POSITION_TOLERANCE, ORIENTATION_TOLERANCE = 1e-3, 1e-2
_COLD_ITERATIONS, _WARM_ITERATIONS = 60, 8
_DAMPING = 1e-5
#: A row stops after a step below this (rad); convergence is about quadratic.
_STILL = 1e-7


class ReachabilityMap:
    """A grid of solved postures, which proves points reachable and starts their solution.

    :param robot: the arm whose workspace is solved.
    """

    def __init__(self, robot: Robot) -> None:
        self._axes = [
            np.linspace(lower, upper, count)
            for lower, upper, count in zip(
                robot.grid_lower, robot.grid_upper, GRID_SHAPE, strict=True
            )
        ]
        self._origin = np.asarray(robot.grid_lower)
        self._most_cells = np.asarray(GRID_SHAPE) - 1
        self._cells_per_metre = self._most_cells / (np.asarray(robot.grid_upper) - self._origin)
        points = np.stack(np.meshgrid(*self._axes, indexing="ij"), axis=-1).reshape(-1, 3)
        self._robot = robot
        scene = compose(Arms(robot, 1, Fingers.LOCKED))
        self._simulation = Simulation(scene, len(points), persistent=False)
        guess = np.tile(np.asarray(robot.home), (len(points), 1))
        # With the base joint turned towards the point, few iterations are needed.
        self._simulation.refresh()
        upwards = np.sign(self._simulation.arm_state().jacobian[:, 0, 5, 0])  # its axis
        guess[:, 0] += upwards * np.arctan2(points[:, 1], points[:, 0])
        joints, reached = self._solved(points, guess, _COLD_ITERATIONS)
        self.postures = joints.reshape(*GRID_SHAPE, -1)
        self.vertex_reached = reached.reshape(GRID_SHAPE)
        corners = self.vertex_reached
        for axis in range(3):
            size = corners.shape[axis]
            low = np.take(corners, range(size - 1), axis=axis)
            corners = low & np.take(corners, range(1, size), axis=axis)
        self._cell_reached = corners

    def reachable(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return whether all corners of the grid cells of points (..., 3), metres, are reached."""
        lowest = self._origin[2]
        height = points[..., 2:]
        lifted = np.where(height >= lowest - BELOW_GRID, np.maximum(height, lowest), height)
        points = np.concatenate([points[..., :2], lifted], axis=-1)
        scaled = (points - self._origin) * self._cells_per_metre
        inside = np.logical_and.reduce((scaled >= 0) & (scaled <= self._most_cells), axis=-1)
        cell = bounded(scaled, 0, self._most_cells - 1).astype(np.intp)
        reached: NDArray[np.bool_] = self._cell_reached[cell[..., 0], cell[..., 1], cell[..., 2]]
        return inside & reached

    def postures_at(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return joint angles (k, dof), radians, that put the tool at points (k, 3).

        :raises RuntimeError: when a point cannot be reached, naming it; points for which
            :meth:`reachable` holds do not raise.
        """
        scaled = (points - self._origin) * self._cells_per_metre
        joints, reached = self._solved_from(np.rint(scaled), points, _WARM_ITERATIONS)
        for corner in product((0, 1), repeat=3):
            if reached.all():
                return joints
            # The nearest posture may be on another branch, or stuck at a joint's limit.
            missed = np.flatnonzero(~reached)
            vertex = np.floor(scaled[missed]) + corner
            joints[missed], reached[missed] = self._solved_from(
                vertex, points[missed], _COLD_ITERATIONS
            )
        if not reached.all():
            raise RuntimeError(f"no posture puts the tool at {points[~reached][0]} m")
        return joints

    def _solved_from(
        self, vertices: NDArray[np.float64], points: NDArray[np.float64], iterations: int
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Solve for points (k, 3) from the postures at grid vertices (k, 3)."""
        index = bounded(vertices, 0, self._most_cells).astype(np.intp)
        joints = self.postures[index[:, 0], index[:, 1], index[:, 2]]
        reached = np.zeros(len(points), dtype=bool)
        for start in range(0, len(points), self._simulation.n):
            part = slice(start, start + self._simulation.n)
            joints[part], reached[part] = self._solved(points[part], joints[part], iterations)
        return joints, reached

    def _solved(
        self, targets: NDArray[np.float64], guess: NDArray[np.float64], iterations: int
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Find joint angles for tool positions by damped least squares.

        Rows are independent: each stops when its own steps have become small.

        :param targets: (k, 3) in the base frame, metres; k at most the number of simulations.
        :param guess: (k, dof) joint angles to start from, radians.
        :param iterations: greatest number of steps.
        :return: joint angles (k, dof), radians, and which targets are reached (k,).
        """
        robot, joints = self._robot, np.array(guess)
        moving = np.ones(len(targets), dtype=bool)
        for _ in range(iterations):
            error, jacobian = self._error(joints, targets)
            step = least_squares_step(jacobian, error, _DAMPING)
            step = bounded(step, -LARGEST_JOINT_STEP, LARGEST_JOINT_STEP)
            moved = bounded(joints + step, np.array(robot.joint_lower), np.array(robot.joint_upper))
            joints[moving] = moved[moving]
            moving &= np.abs(step).max(axis=-1) > _STILL
            if not moving.any():
                break
        error, _ = self._error(joints, targets)
        reached = length(error[:, :3]) < POSITION_TOLERANCE
        reached &= length(error[:, 3:]) < ORIENTATION_TOLERANCE
        return joints, reached

    def _error(
        self, joints: NDArray[np.float64], targets: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return errors (k, rows) and Jacobians (k, rows, dof) of postures (k, dof)."""
        simulation, ids = self._simulation, np.arange(len(targets))
        simulation.qpos[ids[:, None], simulation.scene.joint_qpos[0]] = joints
        simulation.refresh(ids)
        holds = self._robot.holds_orientation
        error, jacobian = tool_error(simulation.arm_state(ids), targets[:, None], holds)
        return error[:, 0], jacobian[:, 0]


@lru_cache(maxsize=8)
def reachability_map(robot: Robot) -> ReachabilityMap:
    """Return the robot's map, solved at the first call (about a second) and then kept."""
    return ReachabilityMap(robot)
