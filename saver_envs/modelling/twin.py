"""Simulate an arm that differs from its data sheet as a real arm does: its twin."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import mujoco
import numpy as np
from mujoco.batch import Batch

from saver_envs.modelling.arms import arm_named, arms_with_twins
from saver_envs.modelling.arms.description import TwinParameters
from saver_envs.modelling.chain import FloatArray
from saver_envs.modelling.mujoco_chain import links_of_model
from saver_envs.modelling.newton_euler import inverse_dynamics
from saver_envs.modelling.trajectories import Trajectory
from saver_envs.robots.drives import torque_driven

#: Physics, controller and torque log run at this rate, 500 Hz (s).
TIME_STEP = 0.002
#: The feed-forward is computed at 100 Hz and held.
FEED_FORWARD_STEPS = 5
#: Steps for which noise and reference are computed at once.
_CHUNK = 5000

#: (n, dof) positions, velocities and accelerations to (n, dof) torques.
InverseDynamics = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True)
class Record:
    """Log of a controlled run: k samples of n arms.

    :param reference: (n, k, dof) reference of the joints.
    :param position: (n, k, dof) true joints.
    :param measured_position: (n, k, dof) readings of the encoders.
    :param measured_torque: (n, k, dof) readings of the drives' torque.
    """

    reference: FloatArray
    position: FloatArray
    measured_position: FloatArray
    measured_torque: FloatArray


def nominal_model(name: str) -> mujoco.MjModel:
    """Return the arm as its maker describes it, driven by torques.

    :param name: the arm's name.
    :raises ValueError: for an arm without a torque-driven model.
    """
    arm = arm_named(name)
    if arm.twin is None:
        raise ValueError(f"robot={name!r}: twins exist of {', '.join(arms_with_twins())}")
    spec = torque_driven(arm.robot)
    for geom in list(spec.geoms):
        spec.delete(geom)
    spec.option.timestep = TIME_STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return spec.compile()


class Twin:
    """A perturbed arm with its sensors and low-level controller.

    It has no contacts: way-points are free of collisions.

    :param name: the arm's name.
    :param parameters: how the plant differs; by default the arm's own.
    :raises ValueError: for an arm without a twin.
    """

    def __init__(self, name: str, parameters: TwinParameters | None = None) -> None:
        self.arm = arm_named(name)
        self.model = model = nominal_model(name)
        given = parameters or self.arm.twin
        assert given is not None  # arms with a torque-driven model have a twin
        self.parameters = given
        joints = [model.joint(joint).id for joint in self.arm.robot.arm_joints]
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

    def track(
        self,
        trajectories: list[Trajectory],
        feed_forward: InverseDynamics | None,
        generator: np.random.Generator,
        log_every: int = 1,
        progress: Callable[[int], None] | None = None,
    ) -> Record:
        """Follow trajectories, each with its own arm, by feed-forward and feedback.

        The torque is ``feed_forward(reference) + stiffness * error + damping * error's rate``; the
        drives saturate and lag. With inverse dynamics as ``feed_forward`` this is computed-torque
        control along the reference.

        :param trajectories: of equal duration.
        :param feed_forward: torques for (q, q', q''), or None for feedback alone.
        :param generator: of the sensors' noise.
        :param log_every: record one in this many steps of 0.002 s.
        :param progress: called with the number of steps since the previous call.
        :raises ValueError: for trajectories of different duration.
        :raises RuntimeError: if the simulation diverges.
        """
        durations = {round(one.duration / TIME_STEP) for one in trajectories}
        if len(durations) != 1:
            raise ValueError("trajectories: must have the same duration")
        steps = durations.pop()
        given = self.parameters
        stiffness, damping = np.asarray(given.stiffness), np.asarray(given.controller_damping)
        response = 1 - np.exp(-TIME_STEP / given.lag)
        limit = np.asarray(given.torque_limit)
        batch = Batch(self.model, nsim=len(trajectories), nthread=1, persistent=True)
        position, velocity, control = (batch.bind(name) for name in ("qpos", "qvel", "ctrl"))
        start = _reference(trajectories, 0, 1)
        position[:] = start[0][:, 0]
        torque = _feed(feed_forward, start)[:, 0]
        logs = []
        for first in range(0, steps, _CHUNK):
            count = min(_CHUNK, steps - first)
            reference = _reference(trajectories, first, count)
            # One row per step: the loop below then reads contiguous memory.
            position_wanted, velocity_wanted, feed = (
                np.ascontiguousarray(one.swapaxes(0, 1))
                for one in (*reference[:2], _feed(feed_forward, reference))
            )
            noise = generator.standard_normal((3, *feed.shape))
            encoder = noise[0] * np.asarray(given.encoder_noise)
            velocity_wanted -= noise[1] * np.asarray(given.velocity_noise)
            position_wanted_noisy = position_wanted - encoder
            true, applied = np.empty_like(feed), np.empty_like(feed)
            for row in range(count):
                true[row] = position
                command = feed[row] + stiffness * (position_wanted_noisy[row] - position)
                command += damping * (velocity_wanted[row] - velocity)
                torque += response * (np.minimum(np.maximum(command, -limit), limit) - torque)
                applied[row] = torque
                control[:] = torque
                batch.step()
            if not np.isfinite(position).all():
                raise RuntimeError(
                    f"the twin's simulation diverged before {first * TIME_STEP:.1f} s"
                )
            measured_torque = applied + noise[2] * np.asarray(given.torque_noise)
            log = position_wanted, true, true + encoder, measured_torque
            logs.append([one[-first % log_every :: log_every] for one in log])
            if progress is not None:
                progress(count)
        return Record(*(np.concatenate(one).swapaxes(0, 1) for one in zip(*logs, strict=True)))


def _reference(trajectories: list[Trajectory], first: int, count: int) -> list[FloatArray]:
    """Return positions, velocities and accelerations (n, count, dof) from a step on."""
    times: FloatArray = np.arange(first, first + count, dtype=np.float64) * TIME_STEP
    parts = [one.at(times) for one in trajectories]
    return [np.stack(part) for part in zip(*parts, strict=True)]


def _feed(feed_forward: InverseDynamics | None, reference: list[FloatArray]) -> FloatArray:
    """Return feed-forward torques (n, count, dof), each held for some steps."""
    n, count, dof = reference[0].shape
    if feed_forward is None:
        return np.zeros((n, count, dof))
    sparse = [one[:, ::FEED_FORWARD_STEPS].reshape(-1, dof) for one in reference]
    torque = feed_forward(*sparse).reshape(n, -1, dof)
    return np.repeat(torque, FEED_FORWARD_STEPS, axis=1)[:, :count]


def nominal_inverse_dynamics(name: str) -> InverseDynamics:
    """Return inverse dynamics with the maker's inertia, as a low-level controller has it.

    :param name: the arm's name.
    :raises ValueError: for an arm without a torque-driven model.
    """
    arm = arm_named(name)
    links = links_of_model(
        nominal_model(name), arm.robot.base_body, arm.robot.arm_joints, arm.chain
    )
    return partial(inverse_dynamics, arm.chain, links)
