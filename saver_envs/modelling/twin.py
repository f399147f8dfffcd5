"""The twin: a simulated arm that differs from its data sheet the way a real one does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from mujoco.batch import Batch

from saver_envs.modelling.arms import Arm, arm_named
from saver_envs.modelling.chain import FloatArray
from saver_envs.modelling.mujoco_chain import links_of_model
from saver_envs.modelling.newton_euler import inverse_dynamics
from saver_envs.modelling.trajectories import Trajectory
from saver_envs.modelling.twin_parameters import TWINS, TwinParameters
from saver_envs.robots import fetch, mico

#: Physics, controller and torque log run at this rate, 500 Hz (s).
TIME_STEP = 0.002
#: The feed-forward is computed at 100 Hz and held.
FEED_FORWARD_STEPS = 5
#: Steps whose noise and reference are made at once.
_CHUNK = 5000

#: (n, dof) positions, velocities and accelerations to (n, dof) torques.
InverseDynamics = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]

_BUILDERS = {"mico": mico.build_torque_driven, "fetch": fetch.build_torque_driven}


@dataclass(frozen=True)
class Record:
    """What a controlled run leaves behind, k samples of n arms.

    :param time: (k,), seconds.
    :param reference: (n, k, dof) where the joints should be.
    :param position: (n, k, dof) where they really are.
    :param measured_position: (n, k, dof) what the encoders say.
    :param commanded_torque: (n, k, dof) what the controller asked for.
    :param measured_torque: (n, k, dof) what the drives say they gave.
    """

    time: FloatArray
    reference: FloatArray
    position: FloatArray
    measured_position: FloatArray
    commanded_torque: FloatArray
    measured_torque: FloatArray


def nominal_model(name: str) -> mujoco.MjModel:
    """Return the arm as its maker describes it, driven by torques.

    :raises ValueError: for an arm without a torque-driven model.
    """
    if name not in _BUILDERS:
        raise ValueError(f"robot={name!r}: twins exist of {', '.join(_BUILDERS)}")
    spec = _BUILDERS[name]()
    for geom in list(spec.geoms):
        spec.delete(geom)
    spec.option.timestep = TIME_STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return spec.compile()


class Twin:
    """The perturbed plant with its sensors and its low-level controller.

    Nothing touches anything: way-points are chosen free of collision beforehand.

    :param name: ``mico`` or ``fetch``.
    :param parameters: what sets it apart; by default the arm's entry of ``TWINS``.
    :raises ValueError: for another arm.
    """

    def __init__(self, name: str, parameters: TwinParameters | None = None) -> None:
        self.arm: Arm = arm_named(name)
        self.model = nominal_model(name)
        self.parameters = TWINS[name] if parameters is None else parameters
        self._perturb()

    def _perturb(self) -> None:
        model, given, robot = self.model, self.parameters, self.arm.robot
        joints = [model.joint(joint).id for joint in robot.arm_joints]
        dofs, bodies = model.jnt_dofadr[joints], model.jnt_bodyid[joints]
        for body, scale in zip(bodies, given.mass_scale, strict=True):
            model.body_mass[body] *= scale
            model.body_inertia[body] *= scale
            model.body_ipos[body] += given.centre_shift
        model.dof_frictionloss[dofs] = given.friction
        model.dof_damping[dofs] = given.damping
        model.dof_armature[dofs] = given.armature
        limit = np.asarray(given.torque_limit)
        model.actuator_forcerange[:] = np.stack([-limit, limit], axis=-1)
        model.jnt_actfrcrange[joints] = np.stack([-limit, limit], axis=-1)
        mujoco.mj_setConst(model, mujoco.MjData(model))

    def with_gain(self, gain: float) -> Twin:
        """Return the same plant with another feedback.

        :param gain: multiple of the stiffness; the damping goes with its root.
        """
        given = self.parameters
        return Twin(
            self.arm.name,
            replace(
                given,
                stiffness=tuple(gain * one for one in given.stiffness),
                controller_damping=tuple(gain**0.5 * one for one in given.controller_damping),
            ),
        )

    def track(
        self,
        trajectories: list[Trajectory],
        feed_forward: InverseDynamics | None,
        generator: np.random.Generator,
        log_every: int = 1,
        progress: Callable[[int], None] | None = None,
    ) -> Record:
        """Follow trajectories, each with an arm of its own, by feed-forward and feedback.

        The torque is ``feed_forward(reference) + stiffness * error + damping * error's rate``; the
        drives saturate and lag. With ``feed_forward`` the inverse dynamics this is the computed
        torque along the reference.

        :param trajectories: of equal duration.
        :param feed_forward: torques for (q, q', q''), or None for feedback alone.
        :param generator: of the sensors' noise.
        :param log_every: record every so many steps of 0.002 s.
        :param progress: is told the number of steps done since it was last told.
        :raises ValueError: for trajectories of different duration.
        :raises RuntimeError: when the simulation breaks down.
        """
        steps = {round(one.duration / TIME_STEP) for one in trajectories}
        if len(steps) != 1:
            raise ValueError("trajectories: all must last equally long")
        run = _Run(self, trajectories, feed_forward, generator, steps.pop(), log_every)
        while run.step < run.steps:
            done = run.advance(min(_CHUNK, run.steps - run.step))
            if progress is not None:
                progress(done)
        return run.record()


class _Run:
    """One closed-loop simulation in progress."""

    def __init__(
        self,
        twin: Twin,
        trajectories: list[Trajectory],
        feed_forward: InverseDynamics | None,
        generator: np.random.Generator,
        steps: int,
        log_every: int,
    ) -> None:
        self._given, self._generator = twin.parameters, generator
        self._trajectories, self._feed_forward = trajectories, feed_forward
        self.step, self.steps, self._log_every = 0, steps, log_every
        n, dof = len(trajectories), twin.arm.dof
        self._batch = Batch(twin.model, nsim=n, nthread=1, persistent=True)
        self._position, self._velocity = self._batch.bind("qpos"), self._batch.bind("qvel")
        self._control = self._batch.bind("ctrl")
        start, _, acceleration = self._reference(0, 1)
        self._position[:] = start[:, 0]
        self._torque = np.zeros((n, dof))
        if feed_forward is not None:
            self._torque[:] = feed_forward(start[:, 0], 0 * start[:, 0], acceleration[:, 0])
        self._logs: list[tuple[FloatArray, ...]] = []

    def _reference(self, first: int, count: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Positions, velocities and accelerations (n, count, dof) from step ``first`` on."""
        times: FloatArray = np.arange(first, first + count, dtype=np.float64) * TIME_STEP
        parts = [one.at(times) for one in self._trajectories]
        position, velocity, acceleration = (np.stack(part) for part in zip(*parts, strict=True))
        return position, velocity, acceleration

    def _feed(self, reference: tuple[FloatArray, FloatArray, FloatArray]) -> FloatArray:
        """Feed-forward torques (n, count, dof), held over some steps."""
        n, count, dof = reference[0].shape
        if self._feed_forward is None:
            return np.zeros((n, count, dof))
        sparse = [one[:, ::FEED_FORWARD_STEPS].reshape(-1, dof) for one in reference]
        torque = self._feed_forward(*sparse).reshape(n, -1, dof)
        return np.repeat(torque, FEED_FORWARD_STEPS, axis=1)[:, :count]

    def advance(self, count: int) -> int:
        """Simulate ``count`` steps and log them."""
        given, generator = self._given, self._generator
        n, dof = self._torque.shape
        reference = self._reference(self.step, count)
        feed = self._feed(reference)
        # One row a step: the loop below then reads neighbouring memory.
        position_wanted, velocity_wanted, feed = (
            np.ascontiguousarray(one.swapaxes(0, 1)) for one in (*reference[:2], feed)
        )
        noise = generator.standard_normal((3, count, n, dof))
        encoder = noise[0] * np.asarray(given.encoder_noise)
        velocity_noise = noise[1] * np.asarray(given.velocity_noise)
        stiffness, damping = np.asarray(given.stiffness), np.asarray(given.controller_damping)
        share = 1 - np.exp(-TIME_STEP / given.lag)
        limit = np.asarray(given.torque_limit)
        true, commanded, applied = (np.empty((count, n, dof)) for _ in range(3))
        velocity_wanted -= velocity_noise
        position_wanted_noisy = position_wanted - encoder
        torque, position, velocity = self._torque, self._position, self._velocity
        for row in range(count):
            true[row] = position
            command = feed[row] + stiffness * (position_wanted_noisy[row] - position)
            command += damping * (velocity_wanted[row] - velocity)
            commanded[row] = command
            torque += share * (np.minimum(np.maximum(command, -limit), limit) - torque)
            applied[row] = torque
            self._control[:] = torque
            self._batch.step()
        if not np.isfinite(position).all():
            raise RuntimeError(f"the twin broke down before {self.step * TIME_STEP:.1f} s")
        measured_torque = applied + noise[2] * np.asarray(given.torque_noise)
        offset = -self.step % self._log_every
        logged = (position_wanted, true, true + encoder, commanded, measured_torque)
        self._logs.append(tuple(one[offset :: self._log_every] for one in logged))
        self.step += count
        return count

    def record(self) -> Record:
        """Return what was logged."""
        joined = [np.concatenate(one).swapaxes(0, 1) for one in zip(*self._logs, strict=True)]
        time: FloatArray = (
            np.arange(joined[0].shape[1], dtype=np.float64) * TIME_STEP * self._log_every
        )
        return Record(time, *joined)


def nominal_inverse_dynamics(name: str) -> InverseDynamics:
    """Return inverse dynamics with the maker's inertia: what a low-level controller would have."""
    arm = arm_named(name)
    links = links_of_model(
        nominal_model(name), arm.robot.base_body, arm.robot.arm_joints, arm.chain
    )
    return lambda position, velocity, acceleration: inverse_dynamics(
        arm.chain, links, position, velocity, acceleration
    )
