"""The robot's bench as the loop uses it: sensors, servos, a clock, and the true state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, dataclass, fields
from typing import Any, Final, Protocol

import numpy as np
from gymnasium.utils import seeding
from numpy.typing import NDArray

from saver_advisors.integration.messages import UNSTAMPED, ArmReading, Floats, Person, Stamp
from saver_envs.cameras.rgbd import BENCH_POSE, KINECT_V2, Camera, CameraPose
from saver_envs.control import Workspace
from saver_envs.episodes import Episodes
from saver_envs.robots import ROBOTS
from saver_envs.robots.description import Robot
from saver_envs.tasks.arm_and_object import ORIENTATION
from saver_envs.world import TIMESTEP

#: Damping of the force estimate, small against squared levers of an arm (m^2).
_FORCE_DAMPING: Final = 1e-4


@dataclass(frozen=True)
class BenchGeometry:
    """Describe the fixed parts of a bench, for stages in any process.

    :param robot: the model of the arms.
    :param base_position: (arms, 3) of the bases, which face along x, metres.
    :param workspace: region of the set-points, in base frames.
    :param held_height: constant height of the set-points (m), or None.
    :param camera: intrinsics and rate of the RGB-D camera.
    :param camera_pose: of the camera, as calibrated.
    """

    robot: Robot
    base_position: NDArray[np.float64]
    workspace: Workspace
    held_height: float | None
    camera: Camera = KINECT_V2
    camera_pose: CameraPose = BENCH_POSE

    def to_mapping(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        return {
            "robot": self.robot.name,
            "base_position": self.base_position.tolist(),
            "workspace": [np.asarray(value).tolist() for value in astuple(self.workspace)],
            "held_height": self.held_height,
            "camera": astuple(self.camera),
            "camera_pose": [value.tolist() for value in astuple(self.camera_pose)],
        }

    @staticmethod
    def from_mapping(values: Mapping[str, Any]) -> BenchGeometry:
        """Restore what :meth:`to_mapping` returned."""
        lower, upper, *reach = values["workspace"]
        workspace = Workspace(np.array(lower), np.array(upper), *reach)
        base, robot = np.array(values["base_position"]), ROBOTS[values["robot"]]
        parts = values["camera"]
        camera: list[Any] = [tuple(one) if isinstance(one, list) else one for one in parts]
        pose = CameraPose(*map(np.array, values["camera_pose"]))
        return BenchGeometry(robot, base, workspace, values["held_height"], Camera(*camera), pose)


class RobotBench(Protocol):
    """Robot arms, sensors and a clock: simulated here, or real."""

    geometry: BenchGeometry

    def picture(self) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Take a picture: colour (height, width, 3), and depth (height, width) in metres."""

    def reset(self, seed: int) -> None:
        """Begin a trial at time 0, drawn from a seed."""

    def advance_to(self, time: float) -> None:
        """Simulate up to the last sub-step that is not after a time, seconds of the trial."""

    def command(self, joints: Floats) -> None:
        """Set the servos' targets (arms, dof), radians, from the next sub-step on."""

    def joint_position(self) -> Floats:
        """Read the joint angles, (arms, dof) radians."""

    def joint_velocity(self) -> Floats:
        """Read the joint velocities, (arms, dof) radians per second."""

    def reading(self, stamp: Stamp) -> ArmReading:
        """Read encoders and force sensors."""

    def truth(self, stamp: Stamp = UNSTAMPED) -> Person:
        """Return the true state of the person."""


class EpisodesBench:
    """Run a single episode of an environment as a bench. Its objects stand for wrists.

    :param episodes: one episode in Cartesian control.
    :raises ValueError: for more than one episode.
    """

    def __init__(self, episodes: Episodes) -> None:
        if episodes.n != 1:
            raise ValueError(f"episodes.n={episodes.n}: a bench is one episode")
        self.episodes = episodes
        self.geometry = BenchGeometry(
            episodes.settings.robot,
            episodes.scene.base_position,
            episodes.task.workspace(episodes.scene.arms),
            episodes.task.held_height,
        )
        self._simulation = episodes.simulation
        #: Contact force on a person's torso, newtons: 0 without a person.
        self.torso_force = 0.0
        self.diverged = False
        self.substeps = 0

    def reset(self, seed: int) -> None:
        """Begin a trial: the episode that the environment begins with this seed."""
        self.episodes.set_generator(0, seeding.np_random(seed)[0])
        self.episodes.reset()
        self.diverged = False
        self.substeps = 0

    def advance_to(self, time: float) -> None:
        """Simulate up to a time; after a divergence the state stays as it is."""
        target = int(time / TIMESTEP + 1e-6)
        if target > self.substeps and not self.diverged:
            self.diverged = bool(self._simulation.advance(target - self.substeps)[0])
            self.substeps = target
            self._after_substeps()

    def _after_substeps(self) -> None:
        """Update running measurements, in subclasses that have any."""

    def command(self, joints: Floats) -> None:
        """Set the servos' targets."""
        self._simulation.ctrl[0, self._simulation.scene.arm_ctrl] = joints

    def joint_position(self) -> Floats:
        """Read the joint angles."""
        return self._simulation.qpos.take(self._simulation.scene.joint_qpos, 1)[0]

    def joint_velocity(self) -> Floats:
        """Read the joint velocities."""
        return self._simulation.qvel.take(self._simulation.scene.joint_dof, 1)[0]

    def reading(self, stamp: Stamp = UNSTAMPED) -> ArmReading:
        """Read encoders and force sensors."""
        state = self._simulation.arm_state()
        torque = self._simulation.contact_torque()[0]
        encoders = {part.name: getattr(state, part.name)[0] for part in fields(state)}
        hand = tool_force(encoders["jacobian"], torque)
        return ArmReading(stamp, **encoders, hand_force=hand, torso_force=self.torso_force)

    def picture(self) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Raise an error, since this bench has no camera.

        :raises NotImplementedError: always.
        """
        raise NotImplementedError("a bench without a person has no camera over it")

    def truth(self, stamp: Stamp = UNSTAMPED) -> Person:
        """Return the true state of objects and targets."""
        episodes = self.episodes
        seen = episodes.task.observe(
            self._simulation, episodes.memory, self._simulation.arm_state()
        )
        targets = episodes.targets()[0]
        return Person(
            stamp=stamp,
            wrists=episodes.scene.to_world(seen["object position"])[0],
            wrist_velocity=seen["object linear velocity"][0],
            wrist_quaternion=seen[ORIENTATION][0],
            wrist_angular_velocity=seen["object angular velocity"][0],
            hips=self._hips(targets),
            targets=targets,
            held=np.zeros(len(targets), dtype=bool),
        )

    def _hips(self, targets: Floats) -> Floats:
        """Return the hip joints (arms, 3), or the targets without a person, metres."""
        return targets


def tool_force(jacobian: Floats, torque: Floats) -> Floats:
    """Estimate the contact force at each tool: the least squares solution of J^T F = torque.

    :param jacobian: (arms, 6, dof).
    :param torque: (arms, dof) of the contacts at the joints, N m.
    :return: (arms,) magnitude, newtons.
    """
    linear = jacobian[:, :3]
    gram = linear @ linear.swapaxes(-1, -2) + _FORCE_DAMPING * np.eye(3)
    force = np.linalg.solve(gram, (linear @ torque[..., None]))[..., 0]
    return np.linalg.norm(force, axis=-1)
