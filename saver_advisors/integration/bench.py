"""The bench as the loop knows it: encoders, force sensors, servos, a clock; and what is true."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np
from gymnasium.utils import seeding
from numpy.typing import NDArray

from saver_advisors.integration.messages import ArmReading, Floats, Stamp
from saver_envs.control import Workspace
from saver_envs.episodes import Episodes
from saver_envs.robots import ROBOTS
from saver_envs.robots.description import Robot
from saver_envs.world import TIMESTEP

#: Damping of the force estimate, small against squared levers of an arm (m^2).
_FORCE_DAMPING: Final = 1e-4


@dataclass(frozen=True)
class Truth:
    """What is really so; row i is what arm i is to push, bench frame.

    :param wrists: (arms, 3) metres
    :param wrist_velocity: (arms, 3) metres per second
    :param wrist_quaternion: (arms, 4) w first
    :param wrist_angular_velocity: (arms, 3) radians per second
    :param hips: (arms, 3) metres
    :param targets: (arms, 3) metres
    """

    wrists: Floats
    wrist_velocity: Floats
    wrist_quaternion: Floats
    wrist_angular_velocity: Floats
    hips: Floats
    targets: Floats


@dataclass(frozen=True)
class Cell:
    """What is fixed about a bench, so that stages elsewhere can know it.

    :param robot: the arms
    :param base_position: (arms, 3) metres; bases face along x
    :param workspace: where set-points may be, in base frames
    :param held_height: of all set-points (m), or None
    """

    robot: Robot
    base_position: NDArray[np.float64]
    workspace: Workspace
    held_height: float | None

    def to_mapping(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        space = self.workspace
        return {
            "robot": self.robot.name,
            "base_position": self.base_position.tolist(),
            "lower": space.lower.tolist(),
            "upper": space.upper.tolist(),
            "hand_reach": space.hand_reach if np.isfinite(space.hand_reach) else None,
            "shoulder_height": space.shoulder_height,
            "held_height": self.held_height,
        }

    @staticmethod
    def from_mapping(values: Mapping[str, Any]) -> Cell:
        """What :meth:`to_mapping` returned."""
        reach = values["hand_reach"]
        workspace = Workspace(
            np.array(values["lower"]),
            np.array(values["upper"]),
            np.inf if reach is None else reach,
            values["shoulder_height"],
        )
        base = np.array(values["base_position"])
        return Cell(ROBOTS[values["robot"]], base, workspace, values["held_height"])


class Bench(Protocol):
    """A robot cell on a clock of its own."""

    cell: Cell
    diverged: bool

    def picture(self) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Take a picture: colour (height, width, 3), and depth (height, width) in metres."""

    def reset(self, seed: int) -> None:
        """Begin a trial at time 0, drawn from a seed."""

    def advance_to(self, time: float) -> None:
        """Simulate up to the last sub-step that is not after a time, seconds of the trial."""

    def command(self, joints: Floats) -> None:
        """Give the servos their targets (arms, dof), radians, from the next sub-step on."""

    def joint_position(self) -> Floats:
        """Read the joint encoders alone, (arms, dof) radians."""

    def joint_velocity(self) -> Floats:
        """Read the joints' speeds alone, (arms, dof) radians per second."""

    def reading(self, stamp: Stamp) -> ArmReading:
        """Read encoders and force sensors."""

    def truth(self) -> Truth:
        """Tell what no sensor tells."""


class EpisodesBench:
    """A single episode of an environment as a bench.

    :param episodes: one episode in Cartesian control
    :raises ValueError: for more than one episode
    """

    def __init__(self, episodes: Episodes) -> None:
        if episodes.n != 1:
            raise ValueError(f"episodes.n={episodes.n}: a bench is one episode")
        self.episodes = episodes
        self.cell = Cell(
            episodes.settings.robot,
            episodes.scene.base_position,
            episodes.regions.workspace,
            episodes.task.held_height,
        )
        self.diverged = False
        self.substeps = 0

    def reset(self, seed: int) -> None:
        """Begin a trial: the episode that the environment begins with this seed."""
        self.episodes.set_generator(0, seeding.np_random(seed)[0])
        self.episodes.reset()
        self.diverged = False
        self.substeps = 0

    def advance_to(self, time: float) -> None:
        """Simulate up to a time; nothing moves any more once the simulation has broken down."""
        target = int(time / TIMESTEP + 1e-6)
        if target > self.substeps and not self.diverged:
            self.diverged = bool(self.episodes.simulation.advance(target - self.substeps)[0])
            self.substeps = target
            self._after_substeps()

    def _after_substeps(self) -> None:
        """Look at what has changed; for benches that keep count of something."""

    def command(self, joints: Floats) -> None:
        """Give the servos their targets."""
        simulation = self.episodes.simulation
        simulation.ctrl[0, simulation.scene.arm_ctrl] = joints

    def joint_position(self) -> Floats:
        """Read the joint encoders alone."""
        simulation = self.episodes.simulation
        return simulation.qpos.take(simulation.scene.joint_qpos, 1)[0]

    def joint_velocity(self) -> Floats:
        """Read the joints' speeds alone."""
        simulation = self.episodes.simulation
        return simulation.qvel.take(simulation.scene.joint_dof, 1)[0]

    def reading(self, stamp: Stamp) -> ArmReading:
        """Read encoders and force sensors."""
        simulation = self.episodes.simulation
        state = simulation.arm_state()
        return ArmReading(
            stamp=stamp,
            joint_position=state.joint_position[0],
            joint_velocity=state.joint_velocity[0],
            tool_position=state.tool_position[0],
            tool_velocity=state.tool_velocity[0],
            tool_rotation=state.tool_rotation[0],
            jacobian=state.jacobian[0],
            hand_force=tool_force(state.jacobian[0], simulation.contact_torque()[0]),
            torso_force=self.torso_force(),
        )

    def hand_force(self) -> Floats:
        """What presses against each tool, (arms,) newtons."""
        simulation = self.episodes.simulation
        return tool_force(simulation.arm_state().jacobian[0], simulation.contact_torque()[0])

    def picture(self) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """There is no camera over this bench.

        :raises NotImplementedError: always
        """
        raise NotImplementedError("a bench without a person has no camera over it")

    def torso_force(self) -> float:
        """What presses on a person's trunk, newtons: nobody is here."""
        return 0.0

    def truth(self) -> Truth:
        """Tell where objects and targets are, objects standing for wrists."""
        simulation = self.episodes.simulation
        objects = simulation.object_state()
        world = objects.world_position[0]
        targets = simulation.to_world(self.episodes.target)[0]
        return Truth(
            wrists=world,
            wrist_velocity=objects.linear_velocity[0],
            wrist_quaternion=objects.quaternion[0],
            wrist_angular_velocity=objects.angular_velocity[0],
            hips=targets,
            targets=targets,
        )


def tool_force(jacobian: Floats, torque: Floats) -> Floats:
    """The force at each tool that explains what contacts do to the joints, newtons.

    :param jacobian: (arms, 6, dof)
    :param torque: (arms, dof) N m
    :return: (arms,) its magnitude, of the least squares solution of J^T F = torque
    """
    linear = jacobian[:, :3]
    gram = linear @ linear.swapaxes(-1, -2) + _FORCE_DAMPING * np.eye(3)
    force = np.linalg.solve(gram, (linear @ torque[..., None]))[..., 0]
    magnitude: Floats = np.linalg.norm(force, axis=-1)
    return magnitude
