"""Description of an arm for its models: kinematics, inertia, workspace, twin and data."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from saver_envs.modelling.chain import Chain, FloatArray
from saver_envs.modelling.newton_euler import Links
from saver_envs.robots.description import Robot


@dataclass(frozen=True)
class Region:
    """Where tool targets are sampled.

    :param lower: corner of a box in the base frame, metres.
    :param upper: the opposite corner.
    :param reach: greatest distance from the shoulder, metres.
    :param turn: largest component of the rotation vector from tool-down, radians; only for poses.
    """

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]
    reach: float = np.inf
    turn: float = 0.15


@dataclass(frozen=True)
class Campaign:
    """Settings that record an arm's data and turn the log into samples (Section 7.3.5).

    :param trajectories: number of trajectories; the last is for testing, the others for training.
    :param way_points: cubics of a trajectory.
    :param interval: duration of a cubic, seconds.
    :param log_every: simulation steps between logged samples.
    :param cut: duration removed from the log at either end, seconds.
    :param window: length of the moving average, in logged samples.
    :param keep_every: one in this many smoothed samples is kept.
    """

    trajectories: int
    way_points: int
    interval: float
    log_every: int
    cut: float
    window: int
    keep_every: int


@dataclass(frozen=True)
class TwinParameters:
    """A twin's plant, sensors and low-level controller; tuples have one entry per joint.

    Units are N m and radians, or N and metres for a lift. All values are ours. They have the order
    of magnitude known from such arms, and were chosen once and not fitted to any result. They
    modify the maker's inertia, not that of Appendix A.

    :param mass_scale: factors of the links' masses.
    :param centre_shift: displacement of all centres of mass along their links' axes, metres.
    :param friction: Coulomb friction.
    :param damping: viscous friction, per 1/s.
    :param armature: reflected inertia of motors and gears.
    :param torque_limit: where the drives saturate.
    :param lag: time constant of the drives' torque, seconds.
    :param torque_noise: standard deviation of a torque reading.
    :param encoder_noise: standard deviation of a position reading.
    :param velocity_noise: standard deviation of the velocity that the controller reads.
    :param stiffness: gain of the controller's position error.
    :param controller_damping: gain of the controller's velocity error.
    """

    mass_scale: tuple[float, ...]
    centre_shift: tuple[float, float, float]
    friction: tuple[float, ...]
    damping: tuple[float, ...]
    armature: tuple[float, ...]
    torque_limit: tuple[float, ...]
    lag: float
    torque_noise: tuple[float, ...]
    encoder_noise: tuple[float, ...]
    velocity_noise: tuple[float, ...]
    stiffness: tuple[float, ...]
    controller_damping: tuple[float, ...]


@dataclass(frozen=True)
class KinematicArm:
    """Everything that the models use of an arm.

    :param robot: its description.
    :param chain: kinematics up to the tool that the data and the paper refer to.
    :param tool_chain: kinematics up to the tool that the environments' set-points refer to.
    :param lower: (dof,) lower bounds of sampled joints, at most one turn, radians or metres.
    :param upper: (dof,) upper bounds of sampled joints.
    :param region: where tool targets are sampled.
    :param appendix_links: returns the inertia in Appendix A, for arms that it lists.
    :param twin: how the arm's twin differs from the maker's description.
    :param campaign: how data are recorded with the twin.
    :param collision_model: returns the model, always the same, against which way-points are checked
        for collisions; None where the height limit suffices.
    :param idle_joints: joints that do not move the tool's position.
    """

    robot: Robot
    chain: Chain
    tool_chain: Chain
    lower: FloatArray
    upper: FloatArray
    region: Region
    appendix_links: Callable[[], Links] | None = None
    twin: TwinParameters | None = None
    campaign: Campaign | None = None
    collision_model: Callable[[], mujoco.MjModel] | None = None
    idle_joints: tuple[int, ...] = ()

    @property
    def dof(self) -> int:
        """Number of joints."""
        return self.chain.dof

    @property
    def target_size(self) -> int:
        """Size of a target: a position, followed by a rotation vector for arms that hold one."""
        return 6 if self.robot.holds_orientation else 3

    @property
    def joint_lower(self) -> FloatArray:
        """Lower joint limits (dof,); minus infinity for continuous joints."""
        return np.asarray(self.robot.joint_lower)

    @property
    def joint_upper(self) -> FloatArray:
        """Upper joint limits (dof,); infinity for continuous joints."""
        return np.asarray(self.robot.joint_upper)


def within_one_turn(robot: Robot) -> tuple[FloatArray, FloatArray]:
    """Return a robot's joint limits (dof,), bounded to one turn for continuous joints."""
    lower = np.maximum(np.asarray(robot.joint_lower), -math.pi)
    return lower, np.minimum(np.asarray(robot.joint_upper), math.pi)
