"""Random trajectories through way-points, like those of the paper's arms.

Between way-points the joints follow cubics with zero speed at the ends (equation 7.14), all of the
same duration. The path to a way-point respects the joints' speed limits, keeps the hand above a
height, and is free of collisions.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from saver_envs.modelling.arms import arm_named
from saver_envs.modelling.arms.description import KinematicArm
from saver_envs.modelling.chain import FloatArray

#: The hand stays above this height (m, Section 7.3.5), which keeps the arm off its table.
LOWEST_HAND = 0.2
#: Ratio of a cubic's peak speed to its mean speed.
_PEAK = 1.5
#: Points of a path that are checked.
_CHECKED = 12
_MOST_DRAWS = 2000


@dataclass(frozen=True)
class Trajectory:
    """Joint motion through way-points, at rest at each.

    :param points: (k + 1, dof), radians or metres.
    :param interval: time from one way-point to the next, seconds.
    """

    points: FloatArray
    interval: float

    @property
    def duration(self) -> float:
        """Seconds from the first way-point to the last."""
        return (len(self.points) - 1) * self.interval

    def at(self, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return positions, velocities and accelerations (m, dof) at times (m,), seconds.

        Before the start and after the end the arm is at rest.
        """
        scaled = np.clip(np.asarray(times) / self.interval, 0, len(self.points) - 1)
        segment = np.minimum(scaled.astype(np.intp), len(self.points) - 2)
        u = (scaled - segment)[:, None]
        start = self.points[segment]
        way = self.points[segment + 1] - start
        position = start + way * (u * u * (3 - 2 * u))
        velocity = way * (6 * u * (1 - u)) / self.interval
        acceleration = way * (6 - 12 * u) / self.interval**2
        return position, velocity, acceleration


def random_trajectory(
    name: str, way_points: int, interval: float, generator: np.random.Generator
) -> Trajectory:
    """Draw a feasible trajectory.

    :param name: the arm's name.
    :param way_points: number of cubics.
    :param interval: duration of each, seconds.
    :param generator: of the way-points.
    :raises RuntimeError: if no feasible way-point is found.
    """
    arm = arm_named(name)
    points = [_draw(arm, None, interval, generator)]
    for _ in range(way_points):
        points.append(_draw(arm, points[-1], interval, generator))
    return Trajectory(np.array(points), interval)


def _draw(
    arm: KinematicArm,
    previous: FloatArray | None,
    interval: float,
    generator: np.random.Generator,
) -> FloatArray:
    """Draw the next way-point, uniformly among the feasible ones."""
    lower, upper = arm.lower, arm.upper
    if previous is not None:
        farthest = np.asarray(arm.robot.joint_speed_limits) * interval / _PEAK
        lower = np.maximum(lower, previous - farthest)
        upper = np.minimum(upper, previous + farthest)
    for _ in range(_MOST_DRAWS):
        point = generator.uniform(lower, upper)
        path = point[None]
        if previous is not None:
            path = previous + np.linspace(0, 1, _CHECKED + 1)[1:, None] * (point - previous)
        if arm.chain.position(path)[:, 2].min() > LOWEST_HAND and not _collides(arm, path):
            return point
    raise RuntimeError(f"{arm.robot.name}: no feasible way-point in {_MOST_DRAWS} draws")


def _collides(arm: KinematicArm, path: FloatArray) -> bool:
    """Return whether the arm touches itself or the ground at one of the postures (m, dof)."""
    if arm.collision_model is None:
        return False
    model = arm.collision_model()
    data = mujoco.MjData(model)
    for posture in path:
        data.qpos[:] = posture
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        if data.ncon:
            return True
    return False
