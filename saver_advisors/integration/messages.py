"""The messages between stages: small frozen dataclasses of plain arrays, each with a stamp.

An annotation contains the shape, which `wire` checks, and ``nan`` where NaN is allowed.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from saver_envs.simulation import ArmState

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Stamp:
    """Identify the measurement that a message is based on.

    :param time: time of the measurement, seconds of the trial. Results that are computed from a
        picture keep the picture's time.
    :param sequence: number of the measurement at its source, kept in the same way.
    :param source: the stage that made the message.
    """

    time: float
    sequence: int
    source: str


#: The stamp of values that no stage has measured.
UNSTAMPED = Stamp(0.0, 0, "")


@dataclass(frozen=True)
class Message:
    """Base class of all messages.

    :param stamp: the measurement that it is based on.
    """

    stamp: Stamp


@dataclass(frozen=True)
class Picture(Message):
    """A frame of the RGB-D camera.

    :param rgb: (height, width, 3).
    :param depth: (height, width), metres along the optical axis; 0 without a measurement.
    """

    rgb: Annotated[NDArray[np.uint8], "height width 3"]
    depth: Annotated[NDArray[np.float32], "height width"]


@dataclass(frozen=True)
class PixelPose(Message):
    """The person with the highest confidence, in the picture.

    :param joints: (14, 2) pixels; NaN for joints that were not found.
    :param scores: (14,) confidence in [0, 1]; 0 for joints that were not found.
    """

    joints: Annotated[Floats, "14 2", "nan"]
    scores: Annotated[Floats, "14"]


@dataclass(frozen=True)
class SpacePose(Message):
    """A person in space, in the camera's frame before the stage "bench frame" and in the bench's
    after it.

    :param positions: (14, 3) metres; NaN where unknown.
    :param scores: (14,) confidence; 0 where unknown.
    """

    positions: Annotated[Floats, "14 3", "nan"]
    scores: Annotated[Floats, "14"]


@dataclass(frozen=True)
class Person(Message):
    """The policy's input about a person, in the bench frame; row i is the wrist of arm i.

    :param wrists: (arms, 3) metres.
    :param wrist_velocity: (arms, 3) metres per second.
    :param wrist_quaternion: (arms, 4) w first; the identity where unknown.
    :param wrist_angular_velocity: (arms, 3) radians per second; 0 where unknown.
    :param hips: (arms, 3) hip joints on the wrists' sides, metres.
    :param targets: (arms, 3) target positions of the wrists, metres.
    :param held: (arms,) whether the wrist is currently hidden and its last position is repeated.
    """

    wrists: Annotated[Floats, "arms 3"]
    wrist_velocity: Annotated[Floats, "arms 3"]
    wrist_quaternion: Annotated[Floats, "arms 4"]
    wrist_angular_velocity: Annotated[Floats, "arms 3"]
    hips: Annotated[Floats, "arms 3"]
    targets: Annotated[Floats, "arms 3"]
    held: Annotated[NDArray[np.bool_], "arms"]


@dataclass(frozen=True)
class ArmReading(Message):
    """Readings of encoders and force sensors, each arm in its own base frame.

    :param joint_position: (arms, dof) radians.
    :param joint_velocity: (arms, dof) radians per second.
    :param tool_position: (arms, 3) metres.
    :param tool_velocity: (arms, 3) metres per second.
    :param tool_rotation: (arms, 3, 3) columns are the tool's axes.
    :param jacobian: (arms, 6, dof) linear rows above angular ones.
    :param hand_force: (arms,) contact force at the tool, estimated from joint torques, newtons.
    :param torso_force: () contact force on the person's torso, newtons.
    """

    joint_position: Annotated[Floats, "arms dof"]
    joint_velocity: Annotated[Floats, "arms dof"]
    tool_position: Annotated[Floats, "arms 3"]
    tool_velocity: Annotated[Floats, "arms 3"]
    tool_rotation: Annotated[Floats, "arms 3 3"]
    jacobian: Annotated[Floats, "arms 6 dof"]
    hand_force: Annotated[Floats, "arms"]
    torso_force: Annotated[float, ""]

    def arm_state(self) -> ArmState:
        """Return the encoders' part as the simulation does, with a leading dimension of 1."""
        return ArmState(**{part.name: getattr(self, part.name)[None] for part in fields(ArmState)})


@dataclass(frozen=True)
class Action(Message):
    """The policy's action.

    :param motion: (arms, 3) displacement of each set-point, as a fraction of the longest one.
    """

    motion: Annotated[Floats, "arms 3"]


@dataclass(frozen=True)
class SetPoints(Message):
    """Tool set-points within the limits.

    :param positions: (arms, 3) metres, each in its arm's base frame.
    """

    positions: Annotated[Floats, "arms 3"]


@dataclass(frozen=True)
class JointTargets(Message):
    """Targets of the joints.

    :param joints: (arms, dof) radians.
    """

    joints: Annotated[Floats, "arms dof"]


@dataclass(frozen=True)
class ServoCommand(Message):
    """The command that the servos were sent.

    :param joints: (arms, dof) radians.
    :param holding: whether the arms hold still.
    :param cause: stage and reason for holding, empty otherwise.
    """

    joints: Annotated[Floats, "arms dof"]
    holding: bool
    cause: str
