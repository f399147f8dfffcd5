"""Random trajectories through way-points, as the paper's arms followed them.

Between way-points the joints follow cubics with zero speed at the ends (equation 7.14), all of the
same duration. A way-point is drawn where the joints can get to within their speed limits, the hand
stays above a height, and nothing collides on the way.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import mujoco
import numpy as np

from saver_envs.modelling.arms import Arm, arm_named
from saver_envs.modelling.chain import FloatArray
from saver_envs.robots import fetch

#: The hand stays above this height (m, Section 7.3.5), which keeps the arm off its table.
LOWEST_HAND = 0.2
#: Peak speed of a cubic is this multiple of its mean speed.
_PEAK = 1.5
#: Points between way-points at which the way is checked.
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

        Before the start and after the end the arm rests.
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

    :param name: ``mico`` or ``fetch``.
    :param way_points: number of cubics.
    :param interval: duration of each, seconds.
    :raises RuntimeError: when no way-point can be found within bounds.
    """
    arm = arm_named(name)
    points = [_draw(arm, None, interval, generator)]
    for _ in range(way_points):
        points.append(_draw(arm, points[-1], interval, generator))
    return Trajectory(np.array(points), interval)


def _draw(
    arm: Arm, previous: FloatArray | None, interval: float, generator: np.random.Generator
) -> FloatArray:
    """Draw the next way-point, uniformly among the feasible ones."""
    lower, upper = arm.lower, arm.upper
    if previous is not None:
        farthest = np.asarray(arm.robot.joint_speed_limits) * interval / _PEAK
        lower, upper = (
            np.maximum(lower, previous - farthest),
            np.minimum(upper, previous + farthest),
        )
    for _ in range(_MOST_DRAWS):
        point = generator.uniform(lower, upper)
        if previous is None:
            way = point[None]
        else:
            way = previous + np.linspace(0, 1, _CHECKED + 1)[1:, None] * (point - previous)
        if arm.chain.position(way)[:, 2].min() <= LOWEST_HAND:
            continue
        if arm.name == "fetch" and _collides(way):
            continue
        return point
    raise RuntimeError(f"{arm.name}: no feasible way-point in {_MOST_DRAWS} draws")


@cache
def _collision_model() -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The Fetch with the ground that its base stands on."""
    spec = fetch.build_torque_driven()
    # The base's hull reaches below its wheels' contact with the ground: only the arm matters.
    ground = spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE, size=(2, 2, 0.1), contype=2, conaffinity=0
    )
    ground.name = "ground"
    for geom in spec.geoms:
        body = geom.parent.name
        if geom.contype and geom.name != "ground" and body != fetch.BASE_BODY:
            geom.conaffinity = 3
    model = spec.compile()
    return model, mujoco.MjData(model)


def _collides(way: FloatArray) -> bool:
    """Say whether the Fetch touches itself or the ground at one of the postures (m, 8)."""
    model, data = _collision_model()
    for posture in way:
        data.qpos[:] = posture
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        if data.ncon:
            return True
    return False
