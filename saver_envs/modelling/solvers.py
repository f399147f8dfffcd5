"""Newton steps behind a guess, and the nearest reachable point where there is no exact answer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saver_envs.control import bounded, least_squares_step, orientation_error
from saver_envs.modelling.arms import Arm
from saver_envs.modelling.chain import Chain, FloatArray, Frames

#: A target counts as reached within these residuals (m, rad).
POSITION_TOLERANCE, ORIENTATION_TOLERANCE = 1e-3, 1e-2
#: Squared damping of a refinement: next to nothing away from singular postures.
_NEWTON_DAMPING = 1e-7
#: Longest step of a joint in one iteration (rad, m).
_LONGEST_STEP = 0.5
_ITERATIONS = 100
#: Damping of the search for the nearest point: first, its changes after a good and a bad step,
#: and its bounds.
_FIRST, _BETTER, _WORSE = 1e-4, 0.3, 4.0
_LEAST, _MOST = 1e-9, 1e3
#: A search is over where its steps have become this small (rad, m).
_STILL = 1e-9
#: And a target is met where the squared error is this small (m^2, rad^2).
_EXACT = 1e-14


@dataclass(frozen=True)
class Reached:
    """Where an arm gets to.

    :param joints: (n, dof), radians and metres, within the joint limits.
    :param position_error: (n,) distance of the tool from its target, metres.
    :param orientation_error: (n,) angle from the target's orientation, radians; 0 for positions.
    :param reached: (n,) whether both are within the tolerances.
    """

    joints: FloatArray
    position_error: FloatArray
    orientation_error: FloatArray

    @property
    def reached(self) -> NDArray[np.bool_]:
        """Return (n,) whether both errors are within the tolerances."""
        return (self.position_error < POSITION_TOLERANCE) & (
            self.orientation_error < ORIENTATION_TOLERANCE
        )


def pose_error(
    position: FloatArray, rotation: FloatArray | None, targets: FloatArray
) -> FloatArray:
    """Return what a tool lacks.

    :param position: (n, 3) of the tool, metres.
    :param rotation: (n, 3, 3) of the tool; poses alone need it.
    :param targets: (n, 3) positions, or (n, 6) positions and rotation vectors from tool-down.
    :return: (n, 3) metres, or (n, 6) with the turn in radians, exact to first order.
    """
    error = targets[:, :3] - position
    if rotation is None or targets.shape[1] == 3:
        return error
    if targets[:, 3:].any():
        rotation = rotation @ rotation_of(targets[:, 3:]).swapaxes(-1, -2)
    return np.concatenate([error, orientation_error(rotation)], axis=1)


def target_error(frames: Frames, targets: FloatArray) -> FloatArray:
    """Return what the tools of n configurations lack; see :func:`pose_error`."""
    return pose_error(frames.tool_position, frames.tool_rotation, targets)


def error_at(joints: FloatArray, targets: FloatArray, chain: Chain) -> FloatArray:
    """Return what the tool lacks at joints (n, dof); see :func:`pose_error`."""
    if targets.shape[1] == 3:
        return pose_error(chain.position(joints), None, targets)
    return pose_error(*chain.tool_pose(joints), targets)


def rotation_of(vectors: FloatArray) -> FloatArray:
    """Return the rotation matrices (n, 3, 3) of rotation vectors (n, 3), radians (Rodrigues)."""
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    x, y, z = (vectors / np.maximum(angle[:, 0], 1e-12)).T
    zero = np.zeros_like(x)
    skew = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(-1, 3, 3)
    rotation: FloatArray = np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * (skew @ skew)
    return rotation


def newton(
    arm: Arm, targets: FloatArray, joints: FloatArray, steps: int, chain: Chain
) -> FloatArray:
    """Return joints after some Newton steps, the shortest that do, within the joint limits.

    :param arm: gives the limits.
    :param targets: (n, 3) or (n, 6).
    :param joints: (n, dof) to start from.
    :param steps: their number.
    :param chain: the arm's, of the tool that the targets are meant for.
    """
    lower, upper = arm.joint_lower, arm.joint_upper
    joints = bounded(joints, lower, upper)
    rows = targets.shape[1]
    for _ in range(steps):
        frames = chain.frames(joints)
        jacobian = chain.jacobian(frames)[:, :rows]
        error = target_error(frames, targets)
        moved = joints + least_squares_step(jacobian, error, _NEWTON_DAMPING)
        beyond = (moved < lower) | (moved > upper)
        if beyond.any():
            # Those joints stay where they are, the others do without them.
            few = np.flatnonzero(beyond.any(axis=1))
            held = jacobian[few] * ~beyond[few, None]
            moved[few] = joints[few] + least_squares_step(held, error[few], _NEWTON_DAMPING)
        step = bounded(moved - joints, -_LONGEST_STEP, _LONGEST_STEP)
        joints = bounded(joints + step, lower, upper)
    return joints


def judge(targets: FloatArray, joints: FloatArray, chain: Chain) -> Reached:
    """Return where the arm is at given joints, seen from its targets."""
    error = error_at(joints, targets, chain)
    return Reached(
        joints,
        np.linalg.norm(error[:, :3], axis=1),
        np.linalg.norm(error[:, 3:], axis=1) if error.shape[1] > 3 else np.zeros(len(error)),
    )


def nearest(arm: Arm, targets: FloatArray, joints: FloatArray, chain: Chain) -> Reached:
    """Return the joints that bring the tool nearest to its targets: Levenberg and Marquardt's way.

    A joint that is at a limit and would go beyond is left out of the step. What is found is the
    nearest point in the neighbourhood of the start; away from joint limits that is the nearest of
    all.

    :param arm: gives the limits.
    :param targets: (n, 3) or (n, 6).
    :param joints: (n, dof) to start from.
    :param chain: the arm's, of the tool that the targets are meant for.
    """
    lower, upper, rows = arm.joint_lower, arm.joint_upper, targets.shape[1]
    joints = bounded(joints, lower, upper)
    damping = np.full(len(joints), _FIRST)
    frames = chain.frames(joints)
    error = target_error(frames, targets)
    for _ in range(_ITERATIONS):
        jacobian = chain.jacobian(frames)[:, :rows].copy()
        uphill = (jacobian * error[:, :, None]).sum(axis=1)
        stuck = ((joints <= lower) & (uphill < 0)) | ((joints >= upper) & (uphill > 0))
        jacobian *= ~stuck[:, None, :]
        step = bounded(_damped(jacobian, error, damping), -_LONGEST_STEP, _LONGEST_STEP)
        tried = bounded(joints + step, lower, upper)
        tried_frames = chain.frames(tried)
        tried_error = target_error(tried_frames, targets)
        better = np.square(tried_error).sum(axis=1) < np.square(error).sum(axis=1)
        damping = bounded(damping * np.where(better, _BETTER, _WORSE), _LEAST, _MOST)
        moved = np.abs(np.where(better[:, None], tried - joints, 0.0)).max(initial=0.0)
        joints = np.where(better[:, None], tried, joints)
        settled = (damping >= _MOST) | (np.square(error).sum(axis=1) < _EXACT)
        if settled.all() or (moved < _STILL and not (~better & ~settled).any()):
            break
        frames = chain.frames(joints)
        error = target_error(frames, targets)
    return judge(targets, joints, chain)


def _damped(jacobian: FloatArray, error: FloatArray, damping: FloatArray) -> FloatArray:
    """Damped least squares with a damping for each row."""
    transposed = jacobian.swapaxes(-1, -2)
    gram = jacobian @ transposed + damping[:, None, None] * np.eye(jacobian.shape[1])
    return (transposed @ np.linalg.solve(gram, error[..., None]))[..., 0]


def reach(
    arm: Arm, targets: FloatArray, present: FloatArray | None = None, chain: Chain | None = None
) -> Reached:
    """Solve inverse kinematics without a model.

    From the present joints directly. Without them, from the home posture along the straight way to
    each target, so that neighbouring targets get neighbouring joints.

    :param arm: the arm.
    :param targets: (n, 3) or (n, 6), metres and radians.
    :param present: (n, dof), or None.
    :param chain: the arm's, with another tool than the paper's.
    """
    chain = chain or arm.chain
    if present is not None:
        return nearest(arm, targets, present, chain)
    home = np.tile(np.asarray(arm.robot.home), (len(targets), 1))
    start = np.zeros(targets.shape[1])
    start[:3] = chain.position(home[:1])[0]
    joints = home
    for share in np.linspace(0, 1, 11)[1:]:
        joints = newton(arm, start + share * (targets - start), joints, 2, chain)
    found = judge(targets, newton(arm, targets, joints, 3, chain), chain)
    missed = ~found.reached
    if not missed.any():
        return found
    joints, better = found.joints.copy(), nearest(arm, targets[missed], found.joints[missed], chain)
    joints[missed] = better.joints
    return judge(targets, joints, chain)
