"""Learned inverse dynamics in use: feed-forward torque, and how well an arm tracks with it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from saver_envs.modelling.chain import FloatArray
from saver_envs.modelling.models import InverseModel, load_model
from saver_envs.modelling.shipped import shipped_model
from saver_envs.modelling.trajectories import Trajectory
from saver_envs.modelling.twin import InverseDynamics, Twin


class LearnedInverseDynamics:
    """Torques for motions, by any inverse dynamics of the table; kept within the torque limits.

    It is what `Twin.track` takes as feed-forward: with its feedback that is computed-torque control
    along the reference.

    :param robot: the arm's name.
    :param model: a fitted model, the path of a weight file, or None for the shipped one.
    :raises ValueError: for a model of another arm or task.
    """

    def __init__(self, robot: str, model: InverseModel | str | Path | None = None) -> None:
        if model is None:
            model = shipped_model(robot, "id")
        elif not isinstance(model, InverseModel):
            model = load_model(Path(model), robot, "id")
        if model.robot != robot or model.task != "id":
            raise ValueError(
                f"model={model.name!r} is of robot {model.robot!r}, task {model.task!r}: "
                f"{robot!r} needs inverse dynamics of its own"
            )
        self.model = model
        self._limit = np.asarray(model.arm.robot.joint_torque_limits)

    def __call__(
        self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> FloatArray:
        """Return torques (n, dof) for positions, velocities and accelerations (n, dof)."""
        motion = np.concatenate([position, velocity, acceleration], axis=1)
        return np.clip(self.model.predict(motion), -self._limit, self._limit)


@dataclass(frozen=True)
class TrackingError:
    """How far an arm was from where it should have been.

    :param rms: root mean square over joints and time, radians (metres of a lift).
    :param per_joint: (dof,) the same of every joint.
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
    """Follow trajectories on a twin and measure the error of its true joints.

    :param twin: the plant.
    :param trajectories: of equal duration.
    :param feed_forward: torques for (q, q', q''), or None for feedback alone.
    :param seed: of the sensors' noise.
    :param gain: the feedback's stiffness as a multiple of the twin's own, its damping as the root
        of that: with soft feedback the feed-forward shows.
    :raises ValueError: for a gain that is not above 0.
    """
    if not gain > 0:
        raise ValueError(f"gain={gain!r}: must be above 0")
    record = twin.with_gain(gain).track(trajectories, feed_forward, np.random.default_rng(seed))
    square = np.square(record.reference - record.position)
    return TrackingError(float(np.sqrt(square.mean())), np.sqrt(square.mean(axis=(0, 1))))
