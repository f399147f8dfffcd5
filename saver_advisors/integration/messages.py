"""What stages tell one another: small frozen dataclasses of plain arrays, each with a stamp."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saver_envs.simulation import ArmState

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Stamp:
    """Where a message comes from.

    :param time: when that was measured which the message tells, seconds of the trial; what is
        computed from a picture keeps the picture's time
    :param sequence: number of the measurement at its source, kept in the same way
    :param source: the stage that made the message
    """

    time: float
    sequence: int
    source: str


@dataclass(frozen=True)
class Message:
    """What every message has.

    :param stamp: where it comes from
    """

    stamp: Stamp


@dataclass(frozen=True)
class Picture(Message):
    """A camera's frame.

    :param rgb: (height, width, 3)
    :param depth: (height, width), metres along the view; 0 where there is no measurement
    """

    rgb: NDArray[np.uint8]
    depth: NDArray[np.float32]


@dataclass(frozen=True)
class PixelPose(Message):
    """The person that is seen most surely, in the picture.

    :param joints: (14, 2) pixels; NaN where a joint was not found
    :param scores: (14,) confidence in [0, 1]; 0 where it was not found
    """

    joints: Floats
    scores: Floats


@dataclass(frozen=True)
class SpacePose(Message):
    """The same in space, in the frame that the stage is about: the camera's, then the bench's.

    :param positions: (14, 3) metres; NaN where unknown
    :param scores: (14,) confidence; 0 where unknown
    """

    positions: Floats
    scores: Floats


@dataclass(frozen=True)
class Person(Message):
    """What the policy needs to know of a person: bench frame, row i is what arm i is to push.

    :param wrists: (arms, 3) metres
    :param wrist_velocity: (arms, 3) metres per second
    :param wrist_quaternion: (arms, 4) w first; the identity where unknown
    :param wrist_angular_velocity: (arms, 3) radians per second; 0 where unknown
    :param hips: (arms, 3) hip joints on the wrists' sides, metres
    :param targets: (arms, 3) where the wrists shall go, metres
    :param held: (arms,) whether the wrist is not seen now and the last place is told
    """

    wrists: Floats
    wrist_velocity: Floats
    wrist_quaternion: Floats
    wrist_angular_velocity: Floats
    hips: Floats
    targets: Floats
    held: NDArray[np.bool_]


@dataclass(frozen=True)
class ArmReading(Message):
    """Encoders and force sensors, each arm in its own base frame.

    :param joint_position: (arms, dof) radians
    :param joint_velocity: (arms, dof) radians per second
    :param tool_position: (arms, 3) metres
    :param tool_velocity: (arms, 3) metres per second
    :param tool_rotation: (arms, 3, 3) columns are the tool's axes
    :param jacobian: (arms, 6, dof) linear rows above angular ones
    :param hand_force: (arms,) what presses against the tool, from joint torques, newtons
    :param torso_force: () what presses on the person's trunk, newtons
    """

    joint_position: Floats
    joint_velocity: Floats
    tool_position: Floats
    tool_velocity: Floats
    tool_rotation: Floats
    jacobian: Floats
    hand_force: Floats
    torso_force: float

    def arm_state(self) -> ArmState:
        """The encoders' part in the form of the simulator's, with a leading dimension of 1."""
        return ArmState(
            joint_position=self.joint_position[None],
            joint_velocity=self.joint_velocity[None],
            tool_position=self.tool_position[None],
            tool_velocity=self.tool_velocity[None],
            tool_rotation=self.tool_rotation[None],
            jacobian=self.jacobian[None],
        )


@dataclass(frozen=True)
class Action(Message):
    """What the policy asks for.

    :param motion: (arms, 3) displacement of each set-point, in shares of the longest one
    """

    motion: Floats


@dataclass(frozen=True)
class SetPoints(Message):
    """Where tools shall go, limits applied.

    :param positions: (arms, 3) metres, each in its arm's base frame
    """

    positions: Floats


@dataclass(frozen=True)
class JointTargets(Message):
    """What joints shall do.

    :param joints: (arms, dof) radians
    """

    joints: Floats


@dataclass(frozen=True)
class ServoCommand(Message):
    """What the servos were told.

    :param joints: (arms, dof) radians
    :param holding: whether the arms hold still
    :param cause: the stage and the reason why, empty otherwise
    """

    joints: Floats
    holding: bool
    cause: str
