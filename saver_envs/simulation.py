"""n simulations of one scene on MuJoCo's native batch: step all, reset some, read the state."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS, Batch, SimulationError
from numpy.typing import NDArray

from saver_envs.scenes import FreeBodies, Scene, rotate
from saver_envs.validation import require, require_kind
from saver_envs.world import TIMESTEP

Kept = TypeVar("Kept")
#: Name of a geom that rests on the table, or of one and of that on which it rests.
Resting = str | tuple[str, str]

#: Substeps of 0.002 s in one action: 25 actions per second.
SUBSTEPS = 20
#: Duration of an action (s): 25 Hz.
ACTION_DURATION = SUBSTEPS * TIMESTEP
#: Contact samples per action (100 Hz), so that brief contacts are not missed.
CONTACT_SAMPLES = 4

#: Joints slower than this (rad/s) have viscous friction, which dry friction turns into at rest.
SLOWEST_DRY = 0.02
_VELOCITY_STAGE = int(mujoco.mjtStage.mjSTAGE_VEL)
_NO_STAGE = int(mujoco.mjtStage.mjSTAGE_NONE)
#: Warnings after which a simulation's state is meaningless, because MuJoCo has reset it: bad
#: positions, velocities and accelerations, which have consecutive numbers.
_DIVERGENCE_WARNINGS = slice(
    int(mujoco.mjtWarning.mjWARN_BADQPOS), int(mujoco.mjtWarning.mjWARN_BADQACC) + 1
)
#: Indices of the factors of a cross product: of the minuends, then of the subtrahends.
_CROSS_FIRST, _CROSS_SECOND = np.array([1, 2, 0, 2, 0, 1]), np.array([2, 0, 1, 1, 2, 0])


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
    """Where objects are, object i in the base frame of arm i; leading dimensions (n, arms).

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
    """Cross product over the last axis; ten times faster than ``numpy.cross`` on few rows."""
    products = first.take(_CROSS_FIRST, -1) * second.take(_CROSS_SECOND, -1)
    return products[..., :3] - products[..., 3:]


class Simulation:
    """n simulations of one scene; a row of every array is one simulation.

    :param scene: compiled models and addresses.
    :param n: number of simulations, at least 1.
    :param threads: native threads that share them; results do not depend on it.
    :param keeps_peaks: keep the highest sample of every sensor in an action.
    :param persistent: keep one ``MjData`` per simulation. Stepping needs it: a step continues from
        the velocity stage of the last one. Pure kinematics saves the memory.
    :raises ValueError: for fewer than one simulation or thread.
    """

    def __init__(
        self,
        scene: Scene,
        n: int,
        threads: int = 1,
        keeps_peaks: bool = False,
        persistent: bool = True,
    ) -> None:
        for name, value in (("n", n), ("threads", threads)):
            require_kind(name, value, "int")
            require(name, value, value >= 1, "at least 1")
        self.scene = scene
        self.n = n
        self._batch = Batch(scene.model, nsim=n, nthread=min(threads, n), persistent=persistent)
        self.qpos = self._batch.bind("qpos")
        self.qvel = self._batch.bind("qvel")
        self.ctrl = self._batch.bind("ctrl")
        #: (n,) time since the reset, seconds.
        self.time = self._batch.bind("time")
        self._anchors = self._batch.bind("xanchor")
        self._axes = self._batch.bind("xaxis")
        #: (n, sites, 3) where the sites are, world frame, metres.
        self.site_position = self._batch.bind("site_xpos")
        self._site_rotation = self._batch.bind("site_xmat")
        #: (n, numbers) what the sensors read.
        self.sensors = self._batch.bind("sensordata")
        self._keeps_peaks = keeps_peaks
        #: (n, sensors) highest of an action's samples, where peaks are kept.
        self.peaks = np.zeros(self.sensors.shape)
        #: (n,) whether the last action had a contact that ``cost_collision`` counts.
        self.collided = np.zeros(n, dtype=bool)
        #: (n,) highest sample of the net force between two things that have such contacts, N.
        self.collision_force = np.zeros(n)
        self._expanded: dict[str, NDArray[Any]] = {}
        self._kept: dict[Any, Any] = {}
        self._constraint_torque = self._batch.bind("qfrc_constraint")
        #: Whether to keep positions at an action's samples, for pictures taken in between.
        self.keep_samples = False
        #: (samples + 1, n, positions) at the beginning of an action and at each of its samples.
        self.samples = np.zeros((CONTACT_SAMPLES + 1, *self.qpos.shape))
        kinds = scene.model.jnt_type[scene.joint_id]
        self._slides = (kinds == int(mujoco.mjtJoint.mjJNT_SLIDE))[..., None]
        self._has_slides = bool(self._slides.any())
        # The batch has two numbers per warning: its last argument and its count.
        self._warnings = self._batch.warning[:, _DIVERGENCE_WARNINGS, 1]
        self._warnings_before = self._warnings.copy()
        self._scratch: tuple[mujoco.MjModel, mujoco.MjData] | None = None
        dofs = scene.joint_dof.ravel()
        self._arm_dofs = _columns(dofs)
        self._collisions = _columns(scene.collision_sensor)
        self._viscosity = scene.model.dof_damping[dofs]
        self._joint_friction = np.zeros((n, dofs.size))
        self._dry = False

    def step(
        self,
        targets: NDArray[np.float64],
        ramp: bool = False,
        ids: NDArray[np.intp] | None = None,
    ) -> NDArray[np.bool_]:
        """Advance simulations by one action (0.04 s).

        Sets :attr:`collided` and :attr:`collision_force`.

        :param targets: (n, actuators) servo targets, radians.
        :param ramp: move the targets there in steps of 0.01 s instead of at once, so that a
            limit on their change limits the joints' speed within the action as well.
        :param ids: (k,) simulations to advance; all by default. The others stay as they are, and
            their entries of the results are False.
        :return: (n,) simulations whose state became meaningless.
        """
        rows = slice(None) if ids is None else ids
        previous = self.ctrl.copy() if ramp else None
        self.ctrl[rows] = targets[rows]
        force = np.zeros(self.n)
        collided = np.zeros(self.n, dtype=bool)
        if self._keeps_peaks:
            self.peaks[rows] = -np.inf
        failed: list[int] = []
        if self.keep_samples:
            self.samples[0] = self.qpos
        for sample in range(1, CONTACT_SAMPLES + 1):
            if previous is not None:
                part = sample / CONTACT_SAMPLES
                self.ctrl[rows] = (previous + (targets - previous) * part)[rows]
            stage = _VELOCITY_STAGE if sample == CONTACT_SAMPLES else _NO_STAGE
            failed += self._advanced(SUBSTEPS // CONTACT_SAMPLES, stage, ids)
            found = self.sensors[:, self._collisions]
            if found.any():
                collided |= np.logical_or.reduce(found, axis=-1)
                if len(self.scene.collision_force_sensor):
                    np.maximum(force, self._greatest_collision_force(), out=force)
            if self.keep_samples:
                self.samples[sample] = self.qpos
            if self._keeps_peaks:
                self.peaks[rows] = np.maximum(self.peaks[rows], self.sensors[rows])
        diverged = self._diverged(failed)
        force[diverged] = 0.0
        stepped = np.zeros(self.n, dtype=bool)
        stepped[rows] = True
        self.collided, self.collision_force = collided & stepped, force * stepped
        return diverged & stepped

    def _greatest_collision_force(self) -> NDArray[np.float64]:
        """Return the greatest force of contacts that ``cost_collision`` counts, (n,), N."""
        forces = self.sensors.take(self.scene.collision_force_sensor, 1)
        return np.sqrt((forces * forces).sum(axis=-1).max(axis=-1, initial=0.0))

    def advance(self, substeps: int) -> NDArray[np.bool_]:
        """Advance all simulations by substeps of 0.002 s, with the servos' targets as they are.

        :param substeps: at least 1.
        :return: ``diverged`` (n,), as in :meth:`step`.
        """
        failed = self._advanced(substeps, _VELOCITY_STAGE)
        if self._keeps_peaks:
            self.peaks[:] = self.sensors
        return self._diverged(failed)

    def _advanced(
        self, substeps: int, stage: int, ids: NDArray[np.intp] | None = None
    ) -> list[int]:
        """Make substeps, and return the simulations that failed."""
        if self._dry:
            self._damp_joints()
        try:
            self._batch.step(ids, substeps, stage)
        except SimulationError as error:
            return [int(index) for index in error.ids]
        return []

    def contact_torque(self) -> NDArray[np.float64]:
        """Return the torques of contacts and joint limits on the arms' joints, (n, arms, dof), N m.

        They are the measured joint torques minus the torques of the arms' own dynamics.
        """
        return self._constraint_torque.take(self.scene.joint_dof, 1)

    def _diverged(self, failed: Sequence[int]) -> NDArray[np.bool_]:
        # One sum finds values that are not finite at a fraction of the cost of checking all rows.
        sound = np.isfinite(self._batch.state.sum())
        if sound and not failed and (self._warnings == self._warnings_before).all():
            return np.zeros(self.n, dtype=bool)
        diverged = np.logical_or.reduce(self._warnings != self._warnings_before, axis=-1)
        diverged |= ~np.logical_and.reduce(np.isfinite(self._batch.state), axis=-1)
        if failed:
            diverged[failed] = True
        self._warnings_before[:] = self._warnings
        return diverged

    def reset(
        self, ids: NDArray[np.intp], joints: NDArray[np.float64], fingers: NDArray[np.float64]
    ) -> None:
        """Put the arms of simulations ``ids`` at rest in the given postures, held by their servos.

        Everything else returns to its initial state. Derived quantities are not updated: place the
        other bodies, then call :meth:`refresh`.

        :param ids: (k,) simulations.
        :param joints: (k, arms, dof) joint angles, radians.
        :param fingers: (k, arms, fingers) finger angles, radians; (k, arms, 0) when locked.
        """
        scene = self.scene
        self._batch.reset(ids, stage=_NO_STAGE)
        rows = ids[:, None, None]
        self.qpos[rows, scene.joint_qpos] = joints
        self.ctrl[rows, scene.arm_ctrl] = joints
        self.qpos[rows, scene.finger_qpos] = fingers
        self.ctrl[rows, scene.finger_ctrl] = fingers
        self.peaks[ids] = 0.0
        self._warnings_before[ids] = self._warnings[ids]

    def touching(self, ids: NDArray[np.intp], resting: Sequence[Resting]) -> NDArray[np.bool_]:
        """Return which of simulations ``ids`` (k,) have contacts, see :meth:`contacts_of`."""
        return np.array([bool(self.contacts_of(int(index), resting)) for index in ids])

    def contacts_of(self, index: int, resting: Sequence[Resting]) -> list[tuple[str, str]]:
        """Return the names of geoms in contact, except for those that rest on something.

        :param index: of the simulation.
        :param resting: see :data:`Resting`.
        """
        if self._scratch is None:
            model = self.model_of(0) if self._expanded else self.scene.model
            self._scratch = model, mujoco.MjData(model)
        model, data = self._scratch
        if self._expanded:
            self.model_of(index, model)
        data.qpos[:] = self.qpos[index]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        named = [(one, "table") if isinstance(one, str) else one for one in resting]
        rests = [{model.geom(first).id, model.geom(second).id} for first, second in named]
        return [
            (model.geom(pair[0]).name, model.geom(pair[1]).name)
            for pair in data.contact.geom.tolist()
            if set(pair) not in rests
        ]

    def keep(self, kind: Callable[[Simulation], Kept]) -> Kept:
        """Return ``kind(self)`` from the first call on, such as addresses that a task needs."""
        if kind not in self._kept:
            self._kept[kind] = kind(self)
        return self._kept[kind]

    def get_state(self) -> NDArray[np.float64]:
        """Return a copy of everything that the simulations' future depends on.

        :return: (n, state size) MuJoCo's integration state: time, positions, velocities, controls
            and the solver's warm start.
        """
        return self._batch.state.copy()

    def set_state(self, state: NDArray[np.float64]) -> None:
        """Go back to a state that :meth:`get_state` returned, of this or an equal simulation.

        :raises ValueError: for a state of another scene or another number of simulations.
        """
        shape = self._batch.state.shape
        if state.shape != shape:
            raise ValueError(f"state of shape {state.shape}: these simulations have {shape}")
        self._batch.state[:] = state
        self.refresh()
        self._warnings_before[:] = self._warnings

    def refresh(self, ids: NDArray[np.intp] | None = None) -> None:
        """Update the derived positions and velocities of simulations ``ids``."""
        self._batch.forward(ids, stage=_VELOCITY_STAGE)

    def per_simulation(self, field: str) -> NDArray[Any]:
        """Return a field of the model that may differ between simulations from now on, (n, ...).

        :param field: its name in ``MjModel``.
        """
        if field not in self._expanded:
            self._expanded[field] = self._batch.expand(field)
        return self._expanded[field]

    def fields(self) -> dict[str, NDArray[Any]]:
        """Return the fields of the model that differ between simulations, (n, ...) each, live."""
        values = {name: self._batch.expanded(name) for name in MODEL_FIELDS}
        return {name: one for name, one in values.items() if one is not None}

    def update_constants(self, ids: NDArray[np.intp]) -> None:
        """Update what MuJoCo derives from the fields of models, after some were written.

        The arms keep the inverse weights that the scene gave them.

        :param ids: (k,) simulations whose fields were written.
        """
        self._batch.set_const(np.sort(ids))
        weights, arms = self.per_simulation("body_invweight0"), self.arm_bodies
        weights[ids[:, None], arms] = self.scene.model.body_invweight0[arms]

    @cached_property
    def applied_force(self) -> NDArray[np.float64]:
        """Forces and torques on bodies, (n, bodies, 6), world frame, N and N m.

        Written ones act from the next step on, until they are written again or at a reset.
        """
        return self._batch.bind("xfrc_applied")

    @cached_property
    def arm_bodies(self) -> NDArray[np.intp]:
        """Ids (k,) of all bodies of all arms."""
        model = self.scene.model
        roots = model.body_rootid[model.jnt_bodyid[self.scene.joint_id[:, 0]]]
        return np.flatnonzero(np.isin(model.body_rootid, roots))

    def give_joint_friction(self, ids: NDArray[np.intp], torque: NDArray[np.float64]) -> None:
        """Give the arms' joints dry friction.

        It acts as a damping that follows the joints' speeds, 100 times a second: MuJoCo's own
        friction loss is a constraint, which takes a quarter of the speed.

        :param ids: (k,) simulations.
        :param torque: (k, arms, dof) against the motion, N m; broadcast to that shape.
        """
        shape = len(ids), *self.scene.joint_dof.shape
        self._joint_friction[ids] = np.broadcast_to(torque, shape).reshape(len(ids), -1)
        dofs = self.scene.joint_dof.ravel()
        self.per_simulation("dof_damping")[ids[:, None], dofs] = self._viscosity
        self._dry = bool(self._joint_friction.any())

    def _damp_joints(self) -> None:
        # In place: it runs between calls of the simulator, with cold caches.
        damping = np.abs(self.qvel[:, self._arm_dofs])
        np.maximum(damping, SLOWEST_DRY, out=damping)
        np.divide(self._joint_friction, damping, out=damping)
        damping += self._viscosity
        self._expanded["dof_damping"][:, self._arm_dofs] = damping

    def model_of(self, index: int, model: mujoco.MjModel | None = None) -> mujoco.MjModel:
        """Return the model of simulation ``index``, in ``model`` if one is given."""
        return self._batch.get_model(index, model)

    def arm_state(self, ids: NDArray[np.intp] | None = None) -> ArmState:
        """Return the arms' state, copied, of simulations ``ids`` (k,) or of all."""
        scene = self.scene

        def of(values: NDArray[np.float64], columns: NDArray[np.intp]) -> NDArray[np.float64]:
            return (values if ids is None else values[ids]).take(columns, 1)

        joint_velocity = of(self.qvel, scene.joint_dof)
        tool = of(self.site_position, scene.tool_site)
        axes = of(self._axes, scene.joint_id)
        levers = tool[:, :, None, :] - of(self._anchors, scene.joint_id)
        linear, angular = cross(axes, levers), axes
        if self._has_slides:  # a lift moves along its axis and turns nothing
            linear = np.where(self._slides, axes, linear)
            angular = np.where(self._slides, 0.0, angular)
        tool_position = tool - scene.base_position
        rotation = of(self._site_rotation, scene.tool_site).reshape(*tool.shape, 3)
        if scene.bases_turned:
            to_base = scene.world_to_base
            linear = rotate(to_base[:, None], linear)
            angular = rotate(to_base[:, None], angular)
            tool_position = rotate(to_base, tool_position)
            rotation = np.sum(to_base[..., None] * rotation[..., None, :, :], axis=-2)
        jacobian = np.concatenate([linear, angular], axis=-1).swapaxes(-1, -2)
        tool_velocity = (jacobian[..., :3, :] * joint_velocity[..., None, :]).sum(axis=-1)
        return ArmState(
            joint_position=of(self.qpos, scene.joint_qpos),
            joint_velocity=joint_velocity,
            tool_position=tool_position,
            tool_velocity=tool_velocity,
            tool_rotation=rotation,
            jacobian=jacobian,
        )

    def object_state(self, bodies: FreeBodies) -> ObjectState:
        """Return the state of bodies, copied, body i in the base frame of arm i.

        :param bodies: one per arm.
        """
        scene = self.scene
        pose = self.qpos.take(bodies.qpos, 1)
        velocity = self.qvel.take(bodies.dof, 1)
        world_position, quaternion = pose[..., :3], pose[..., 3:]
        position = world_position - scene.base_position
        linear_velocity = velocity[..., :3]
        # A free joint's angular velocity is given in the body's own frame.
        angular_velocity = rotate_by_quaternion(quaternion, velocity[..., 3:])
        if scene.bases_turned:
            position = rotate(scene.world_to_base, position)
            linear_velocity = rotate(scene.world_to_base, linear_velocity)
            angular_velocity = rotate(scene.world_to_base, angular_velocity)
            yaw = np.arctan2(scene.base_rotation[:, 1, 0], scene.base_rotation[:, 0, 0])
            zero = np.zeros_like(yaw)
            back = np.stack([np.cos(yaw / 2), zero, zero, -np.sin(yaw / 2)], axis=-1)
            quaternion = multiply_quaternions(back, quaternion)
        np.negative(quaternion, out=quaternion, where=quaternion[..., :1] < 0)
        return ObjectState(position, quaternion, linear_velocity, angular_velocity, world_position)

    def off_table(self) -> NDArray[np.bool_]:
        """Return where a body with a free joint has its centre beyond the table's edge, (n,)."""
        over = self.scene.table.contains(self.qpos.take(self.scene.loose_qpos, 1))
        return ~np.logical_and.reduce(over, axis=-1)

    def finger_state(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return finger angles (rad) and velocities (rad/s), (n, arms, fingers) each, copied."""
        scene = self.scene
        return self.qpos.take(scene.finger_qpos, 1), self.qvel.take(scene.finger_dof, 1)

    def copy_into(self, index: int, data: mujoco.MjData) -> None:
        """Write simulation ``index`` into ``data``, to render it."""
        self._batch.get_data(index, data)


def _columns(indices: NDArray[np.intp]) -> slice | NDArray[np.intp]:
    """Return consecutive indices as a slice, which is faster."""
    together = len(indices) > 0 and bool((np.diff(indices) == 1).all())
    return slice(int(indices[0]), int(indices[-1]) + 1) if together else indices


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
