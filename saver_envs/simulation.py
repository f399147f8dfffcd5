"""n simulations of one scene on MuJoCo's native batch: step, reset some, read fresh state."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError
from numpy.typing import NDArray

from saver_envs.scenes import Scene

#: Substeps of 0.002 s in one action: 25 actions a second.
SUBSTEPS = 20
#: Contacts are sampled this many times in an action (100 Hz), so that a brief touch is seen.
CONTACT_SAMPLES = 4

_POSITION_STAGE = int(mujoco.mjtStage.mjSTAGE_POS)
_VELOCITY_STAGE = int(mujoco.mjtStage.mjSTAGE_VEL)
_NO_STAGE = int(mujoco.mjtStage.mjSTAGE_NONE)
#: Warnings after which a simulation's state means nothing (MuJoCo has reset it by itself).
_DIVERGENCE_WARNINGS = [
    int(mujoco.mjtWarning.mjWARN_BADQPOS),
    int(mujoco.mjtWarning.mjWARN_BADQVEL),
    int(mujoco.mjtWarning.mjWARN_BADQACC),
]


@dataclass(frozen=True)
class ArmState:
    """Where the arms are, each in its own base frame; leading dimensions (n, arms).

    :param joint_position: (n, arms, dof), radians.
    :param joint_velocity: (n, arms, dof), radians per second.
    :param tool_position: (n, arms, 3), metres.
    :param tool_velocity: (n, arms, 3), metres per second.
    :param tool_rotation: (n, arms, 3, 3), columns are the tool's axes.
    :param jacobian: (n, arms, 6, dof), linear rows (m/rad) above angular ones (rad/rad).
    """

    joint_position: NDArray[np.float64]
    joint_velocity: NDArray[np.float64]
    tool_position: NDArray[np.float64]
    tool_velocity: NDArray[np.float64]
    tool_rotation: NDArray[np.float64]
    jacobian: NDArray[np.float64]


@dataclass(frozen=True)
class ObjectState:
    """Where the cubes are, cube i in the base frame of arm i; leading dimensions (n, arms).

    :param position: (n, arms, 3), metres.
    :param quaternion: (n, arms, 4), w first, w >= 0.
    :param linear_velocity: (n, arms, 3), metres per second.
    :param angular_velocity: (n, arms, 3), radians per second, in the base frame.
    :param world_position: (n, arms, 3), metres, world frame.
    """

    position: NDArray[np.float64]
    quaternion: NDArray[np.float64]
    linear_velocity: NDArray[np.float64]
    angular_velocity: NDArray[np.float64]
    world_position: NDArray[np.float64]


def cross(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cross product over the last axis; several times faster than ``numpy.cross`` on few rows."""
    a0, a1, a2 = first[..., 0], first[..., 1], first[..., 2]
    b0, b1, b2 = second[..., 0], second[..., 1], second[..., 2]
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], axis=-1)


def rotate(rotation: NDArray[np.float64], vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Apply (..., 3, 3) rotations to (..., 3) vectors, with a fixed order of summation."""
    return np.sum(rotation * vector[..., None, :], axis=-1)


class Simulation:
    """n simulations of one scene; a row of every array is one simulation.

    :param scene: the compiled bench.
    :param n: number of simulations, at least 1.
    :param threads: native threads that share them; results do not depend on it.
    :param persistent: keep one ``MjData`` a simulation. Stepping wants it: the last velocity
        stage of a step is then the first of the next. Pure kinematics does without the memory.
    :raises ValueError: for fewer than one simulation or thread.
    """

    def __init__(
        self, scene: Scene, n: int, threads: int = 1, persistent: bool = True
    ) -> None:
        if n < 1:
            raise ValueError(f"n={n!r}: at least one simulation is needed")
        if threads < 1:
            raise ValueError(f"threads={threads!r}: at least one thread is needed")
        self.scene = scene
        self.n = n
        self._batch = Batch(scene.model, nsim=n, nthread=min(threads, n), persistent=persistent)
        self.qpos = self._batch.bind("qpos")
        self.qvel = self._batch.bind("qvel")
        self.ctrl = self._batch.bind("ctrl")
        self._anchors = self._batch.bind("xanchor")
        self._axes = self._batch.bind("xaxis")
        self._site_position = self._batch.bind("site_xpos")
        self._site_rotation = self._batch.bind("site_xmat")
        self._sensors = self._batch.bind("sensordata")
        self._warnings_before = np.zeros((n, len(_DIVERGENCE_WARNINGS)), dtype=np.int64)
        self._bases_turned = not np.array_equal(
            scene.base_rotation, np.broadcast_to(np.eye(3), scene.base_rotation.shape)
        )
        self._world_to_base = np.swapaxes(scene.base_rotation, -1, -2)

    def step(
        self, targets: NDArray[np.float64], ramp: bool = False
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Advance all simulations by one action (0.04 s).

        :param targets: (n, actuators) servo targets, radians.
        :param ramp: move the targets there in steps of 0.01 s instead of at once, so that a
            limit on their change limits the joints' speed within the action as well.
        :return: ``collided`` (n,), contact that ``cost_collision`` counts at one of the samples,
            and ``diverged`` (n,), simulations whose state became meaningless.
        """
        collided = np.zeros(self.n, dtype=bool)
        substeps = SUBSTEPS // CONTACT_SAMPLES
        failed: list[int] = []
        previous = self.ctrl.copy()
        self.ctrl[:] = targets
        for sample in range(1, CONTACT_SAMPLES + 1):
            if ramp:
                self.ctrl[:] = previous + (targets - previous) * (sample / CONTACT_SAMPLES)
            stage = _VELOCITY_STAGE if sample == CONTACT_SAMPLES else _NO_STAGE
            try:
                self._batch.step(nstep=substeps, stage=stage)
            except SimulationError as error:
                failed.extend(int(i) for i in error.ids)
            collided |= self._sensors[:, self.scene.collision_sensor].any(axis=-1)
        return collided, self._diverged(failed)

    def _diverged(self, failed: list[int]) -> NDArray[np.bool_]:
        warnings = self._warning_counts()
        diverged = (warnings != self._warnings_before).any(axis=-1)
        diverged |= ~np.isfinite(self.qpos).all(axis=-1)
        diverged |= ~np.isfinite(self.qvel).all(axis=-1)
        diverged[failed] = True
        self._warnings_before[:] = warnings
        return diverged

    def _warning_counts(self) -> NDArray[np.int32]:
        # The batch gives two numbers a warning: its last argument and how often it came.
        return self._batch.warning[:, _DIVERGENCE_WARNINGS, 1]

    def reset(
        self,
        ids: NDArray[np.intp],
        joints: NDArray[np.float64],
        fingers: NDArray[np.float64],
        objects: NDArray[np.float64],
    ) -> None:
        """Put simulations ``ids`` at rest in the given postures, servos holding them.

        :param ids: (k,) simulations.
        :param joints: (k, arms, dof) joint angles, radians.
        :param fingers: (k, arms, fingers) finger angles, radians; (k, arms, 0) when locked.
        :param objects: (k, arms, 7) cubes' positions (m) and quaternions, world frame.
        """
        scene = self.scene
        self._batch.reset(ids, stage=_NO_STAGE)
        rows = ids[:, None, None]
        self.qpos[rows, scene.joint_qpos] = joints
        self.ctrl[rows, scene.arm_ctrl] = joints
        self.qpos[rows, scene.finger_qpos] = fingers
        self.ctrl[rows, scene.finger_ctrl] = fingers
        self.qpos[rows, scene.object_qpos] = objects
        self.refresh(ids)
        self._warnings_before[ids] = self._warning_counts()[ids]

    def refresh(self, ids: NDArray[np.intp] | None = None) -> None:
        """Bring positions and velocities of simulations ``ids`` up to date with their state."""
        self._batch.forward(ids, stage=_VELOCITY_STAGE)

    def arm_state(self, ids: NDArray[np.intp] | None = None) -> ArmState:
        """Return the arms' state, copied, of simulations ``ids`` (k,) or of all."""
        scene = self.scene
        rows = slice(None) if ids is None else ids
        joint_velocity = self.qvel[rows][:, scene.joint_dof]
        tool = self._site_position[rows][:, scene.tool_site]
        axes = self._axes[rows][:, scene.joint_id]
        levers = tool[:, :, None, :] - self._anchors[rows][:, scene.joint_id]
        linear, angular = cross(axes, levers), axes
        tool_position = tool - scene.base_position
        rotation = self._site_rotation[rows][:, scene.tool_site].reshape(*tool.shape, 3)
        if self._bases_turned:
            to_base = self._world_to_base
            linear = rotate(to_base[:, None], linear)
            angular = rotate(to_base[:, None], angular)
            tool_position = rotate(to_base, tool_position)
            rotation = np.sum(to_base[..., None] * rotation[..., None, :, :], axis=-2)
        jacobian = np.swapaxes(np.concatenate([linear, angular], axis=-1), -1, -2)
        tool_velocity = np.sum(jacobian[..., :3, :] * joint_velocity[..., None, :], axis=-1)
        return ArmState(
            joint_position=self.qpos[rows][:, scene.joint_qpos],
            joint_velocity=joint_velocity,
            tool_position=tool_position,
            tool_velocity=tool_velocity,
            tool_rotation=rotation,
            jacobian=jacobian,
        )

    def object_state(self) -> ObjectState:
        """Return the cubes' state, copied."""
        scene = self.scene
        pose = self.qpos[:, scene.object_qpos]
        velocity = self.qvel[:, scene.object_dof]
        world_position, quaternion = pose[..., :3], pose[..., 3:]
        position = world_position - scene.base_position
        linear_velocity = velocity[..., :3]
        # A free joint's angular velocity is given in the body's own frame.
        angular_velocity = rotate_by_quaternion(quaternion, velocity[..., 3:])
        if self._bases_turned:
            position = rotate(self._world_to_base, position)
            linear_velocity = rotate(self._world_to_base, linear_velocity)
            angular_velocity = rotate(self._world_to_base, angular_velocity)
            quaternion = multiply_quaternions(self._base_quaternion_inverse, quaternion)
        quaternion = np.where(quaternion[..., :1] < 0, -quaternion, quaternion)
        return ObjectState(position, quaternion, linear_velocity, angular_velocity, world_position)

    @property
    def _base_quaternion_inverse(self) -> NDArray[np.float64]:
        yaw = np.arctan2(self.scene.base_rotation[:, 1, 0], self.scene.base_rotation[:, 0, 0])
        zero = np.zeros_like(yaw)
        return np.stack([np.cos(yaw / 2), zero, zero, -np.sin(yaw / 2)], axis=-1)

    def finger_state(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return finger angles (rad) and velocities (rad/s), (n, arms, fingers) each, copied."""
        return self.qpos[:, self.scene.finger_qpos], self.qvel[:, self.scene.finger_dof]

    def to_world(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Turn base-frame points (..., arms, 3) into world-frame ones, metres."""
        if self._bases_turned:
            points = rotate(self.scene.base_rotation, points)
        return points + self.scene.base_position

    def copy_into(self, index: int, data: mujoco.MjData) -> None:
        """Write simulation ``index`` into ``data``, to render it."""
        self._batch.get_data(index, data)


def rotate_by_quaternion(
    quaternion: NDArray[np.float64], vector: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Turn (..., 3) vectors by (..., 4) unit quaternions, w first."""
    w, xyz = quaternion[..., :1], quaternion[..., 1:]
    twice = 2 * cross(xyz, vector)
    return vector + w * twice + cross(xyz, twice)


def multiply_quaternions(
    first: NDArray[np.float64], second: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Hamilton product of (..., 4) quaternions, w first."""
    w1, v1 = first[..., :1], first[..., 1:]
    w2, v2 = second[..., :1], second[..., 1:]
    w = w1 * w2 - np.sum(v1 * v2, axis=-1, keepdims=True)
    return np.concatenate([w, w1 * v2 + w2 * v1 + cross(v1, v2)], axis=-1)
