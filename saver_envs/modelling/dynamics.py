"""Learned inverse dynamics as feed-forward torque, and the tracking error of a twin with it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from saver_envs.modelling.chain import FloatArray
from saver_envs.modelling.models import InverseModel
from saver_envs.modelling.shipped import model_for
from saver_envs.modelling.trajectories import Trajectory
from saver_envs.modelling.twin import InverseDynamics, Twin


class LearnedInverseDynamics:
    """Torques for motions by any inverse dynamics model, clipped to the torque limits.

    `Twin.track` accepts it as feed-forward; with the twin's feedback this is computed-torque
    control along the reference.

    :param robot: the arm's name.
    :param model: a fitted model, the path of a weight file, or None for the shipped model.
    :raises ValueError: for a model of another arm or task.
    """

    def __init__(self, robot: str, model: InverseModel | str | Path | None = None) -> None:
        self.model = model_for(robot, "id", model)
        self._limit = np.asarray(self.model.arm.robot.joint_torque_limits)

    def __call__(
        self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> FloatArray:
        """Return torques (n, dof) for positions, velocities and accelerations (n, dof)."""
        motion = np.concatenate([position, velocity, acceleration], axis=1)
        return np.clip(self.model.predict(motion), -self._limit, self._limit)


@dataclass(frozen=True)
class TrackingError:
    """Distance of an arm's joints from their reference.

    :param rms: root mean square over joints and time, radians (metres for a lift).
    :param per_joint: (dof,) root mean square over time.
    """

    rms: float
    per_joint: FloatArray


def tracking_error(
    twin: Twin,
    trajectories: list[Trajectory],
    feed_forward: InverseDynamics | None,
    seed: int = 0,
    gain: float = 1.0,
) -> TrackingError:
    """Follow trajectories with a twin and measure the error of its true joints.

    :param twin: the plant.
    :param trajectories: of equal duration.
    :param feed_forward: torques for (q, q', q''), or None for feedback alone.
    :param seed: of the sensors' noise.
    :param gain: factor of the feedback's stiffness; its damping is scaled by the square root. Soft
        feedback shows the quality of the feed-forward.
    :raises ValueError: for a gain that is not above 0.
    """
    if not gain > 0:
        raise ValueError(f"gain={gain!r}: must be above 0")
    given = twin.parameters
    stiffness = tuple(gain * one for one in given.stiffness)
    damping = tuple(gain**0.5 * one for one in given.controller_damping)
    changed = replace(given, stiffness=stiffness, controller_damping=damping)
    plant = Twin(twin.arm.robot.name, changed)
    record = plant.track(trajectories, feed_forward, np.random.default_rng(seed))
    square = np.square(record.reference - record.position)
    return TrackingError(float(np.sqrt(square.mean())), np.sqrt(square.mean(axis=(0, 1))))
