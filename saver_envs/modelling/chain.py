"""Forward kinematics of serial chains of hinges and slides, batched over configurations.

Both a Denavit-Hartenberg table and a compiled MuJoCo model convert to a chain. Link ``i`` has the
frame ``before[i] J(q_i) after[i]`` in that of link ``i - 1``, where ``J`` rotates about the z axis
or moves along it. Results are in the frame of the arm's base, in metres and radians.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saver_envs.simulation import cross

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Frames:
    """Frames of a chain in n configurations.

    :param axis: (dof, n, 3) unit vectors along or about which a joint moves.
    :param anchor: (dof, n, 3) a point of each joint's axis, metres.
    :param link_rotation: (dof, n, 3, 3), columns are the axes of the links' frames.
    :param link_position: (dof, n, 3) origins of the links' frames, metres.
    :param tool_rotation: (n, 3, 3), columns are the tool's axes.
    :param tool_position: (n, 3), metres.
    """

    axis: FloatArray
    anchor: FloatArray
    link_rotation: FloatArray
    link_position: FloatArray
    tool_rotation: FloatArray
    tool_position: FloatArray


@dataclass(frozen=True)
class Chain:
    """A serial arm.

    :param before: (dof, 4, 4) fixed transform from the previous link's frame to the joint.
    :param after: (dof, 4, 4) fixed transform from the moved joint to the link's frame.
    :param direction: (dof,) 1, or -1 for a joint that moves against the z axis.
    :param prismatic: (dof,) which joints slide.
    :param tool: (4, 4) the tool in the frame of the last link.
    """

    before: FloatArray
    after: FloatArray
    direction: FloatArray
    prismatic: NDArray[np.bool_]
    tool: FloatArray

    @property
    def dof(self) -> int:
        """Number of joints."""
        return len(self.direction)

    def frames(self, joints: FloatArray) -> Frames:
        """Return the frames of all links and the tool.

        :param joints: (n, dof), radians, or metres for slides.
        :raises ValueError: for another shape.
        """
        joints = self._checked(joints)
        n, dof = joints.shape
        axis, anchor = np.empty((dof, n, 3)), np.empty((dof, n, 3))
        link_rotation, link_position = np.empty((dof, n, 3, 3)), np.empty((dof, n, 3))
        rotation, position = np.broadcast_to(np.eye(3), (n, 3, 3)), np.zeros((n, 3))
        moves = joints * self.direction
        sines, cosines = np.sin(moves), np.cos(moves)
        for index in range(dof):
            rotation, position = _compose(rotation, position, self.before[index])
            axis[index] = rotation[:, :, 2] * self.direction[index]
            anchor[index] = position
            if self.prismatic[index]:
                position = position + rotation[:, :, 2] * moves[:, index, None]
            else:
                rotation = _turned(rotation, sines[:, index, None], cosines[:, index, None])
            rotation, position = _compose(rotation, position, self.after[index])
            link_rotation[index], link_position[index] = rotation, position
        rotation, position = _compose(rotation, position, self.tool)
        return Frames(axis, anchor, link_rotation, link_position, rotation, position)

    def position(self, joints: FloatArray) -> FloatArray:
        """Return the tool's position (n, 3), metres, at joints (n, dof)."""
        return self.frames(joints).tool_position

    def jacobian(self, frames: Frames) -> FloatArray:
        """Return the tool's Jacobian (n, 6, dof): linear rows above angular ones."""
        linear = cross(frames.axis, frames.tool_position - frames.anchor)
        angular = frames.axis
        if self.prismatic.any():
            slides = self.prismatic[:, None, None]
            linear = np.where(slides, frames.axis, linear)
            angular = np.where(slides, 0.0, angular)
        return np.concatenate([linear, angular], axis=-1).transpose(1, 2, 0)

    def _checked(self, joints: FloatArray) -> FloatArray:
        joints = np.asarray(joints, dtype=np.float64)
        if joints.ndim != 2 or joints.shape[1] != self.dof:
            raise ValueError(f"joints of shape {joints.shape}: must have shape (n, {self.dof})")
        return joints


def _compose(
    rotation: FloatArray, position: FloatArray, fixed: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return frames (n) followed by a fixed transform (4, 4)."""
    n = len(position)
    moved = position + (rotation.reshape(3 * n, 3) @ fixed[:3, 3]).reshape(n, 3)
    return (rotation.reshape(3 * n, 3) @ fixed[:3, :3]).reshape(n, 3, 3), moved


def _turned(rotation: FloatArray, sine: FloatArray, cosine: FloatArray) -> FloatArray:
    """Return frames (n, 3, 3) rotated about their own z axes; sine and cosine are (n, 1)."""
    x, y = rotation[:, :, 0], rotation[:, :, 1]
    return np.stack([cosine * x + sine * y, cosine * y - sine * x, rotation[:, :, 2]], axis=-1)
