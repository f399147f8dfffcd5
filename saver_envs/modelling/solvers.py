"""Inverse kinematics by Newton steps, and the nearest reachable point where no solution exists."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saver_envs.control import bounded, least_squares_step, orientation_error
from saver_envs.modelling.arms.description import KinematicArm
from saver_envs.modelling.chain import Chain, FloatArray, Frames

#: A target counts as reached within these residuals (m, rad).
POSITION_TOLERANCE, ORIENTATION_TOLERANCE = 1e-3, 1e-2
#: Squared damping of Newton steps: negligible except near singular postures.
_NEWTON_DAMPING = 1e-7
#: Largest step of a joint in one iteration (rad, m).
_LARGEST_STEP = 0.5
_ITERATIONS = 100
#: Damping of the search for the nearest point: initial value, factors after a good and a bad step,
#: and bounds.
_INITIAL, _BETTER, _WORSE = 1e-4, 0.3, 4.0
_LEAST, _MOST = 1e-9, 1e3
#: The search stops when its steps are this small (rad, m) ...
_STILL = 1e-9
#: ... or the squared error is (m^2, rad^2).
_EXACT = 1e-14


@dataclass(frozen=True)
class Solution:
    """Joints for targets, and the remaining errors.

    :param joints: (n, dof), radians and metres, within the joint limits.
    :param error: (n,) distance of the tool from its target, metres.
    :param orientation_error: (n,) angle from the target's orientation, radians; 0 for positions.
    """

    joints: FloatArray
    error: FloatArray
    orientation_error: FloatArray

    @property
    def reachable(self) -> NDArray[np.bool_]:
        """Return (n,) whether the target is reached to 1 mm and 0.01 rad."""
        return (self.error < POSITION_TOLERANCE) & (self.orientation_error < ORIENTATION_TOLERANCE)


def pose_error(frames: Frames, targets: FloatArray) -> FloatArray:
    """Return the displacement from tools to targets.

    :param frames: of the arm in n configurations.
    :param targets: (n, 3) positions, or (n, 6) positions and rotation vectors from tool-down.
    :return: (n, 3) metres, or (n, 6) with the rotation in radians, exact to first order.
    """
    error, rotation = targets[:, :3] - frames.tool_position, frames.tool_rotation
    if targets.shape[1] == 3:
        return error
    if targets[:, 3:].any():
        rotation = rotation @ rotation_of(targets[:, 3:]).swapaxes(-1, -2)
    return np.concatenate([error, orientation_error(rotation)], axis=1)


def rotation_of(vectors: FloatArray) -> FloatArray:
    """Return the rotation matrices (n, 3, 3) of rotation vectors (n, 3), radians (Rodrigues)."""
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    x, y, z = (vectors / np.maximum(angle[:, 0], 1e-12)).T
    zero = np.zeros_like(x)
    skew = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(-1, 3, 3)
    return np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * (skew @ skew)


def newton(
    arm: KinematicArm, targets: FloatArray, joints: FloatArray, steps: int, chain: Chain
) -> FloatArray:
    """Return joints (n, dof) after least-norm Newton steps within the joint limits.

    :param arm: gives the limits.
    :param targets: (n, 3) or (n, 6).
    :param joints: (n, dof) to start from.
    :param steps: number of steps.
    :param chain: the arm's chain up to the tool that the targets refer to.
    """
    lower, upper = arm.joint_lower, arm.joint_upper
    joints = bounded(joints, lower, upper)
    for _ in range(steps):
        jacobian, error = _linearised(chain.frames(joints), targets, chain)
        moved = joints + least_squares_step(jacobian, error, _NEWTON_DAMPING)
        beyond = (moved < lower) | (moved > upper)
        if beyond.any():
            # Those joints stay where they are; the other joints make up for them.
            few = np.flatnonzero(beyond.any(axis=1))
            held = jacobian[few] * ~beyond[few, None]
            moved[few] = joints[few] + least_squares_step(held, error[few], _NEWTON_DAMPING)
        step = bounded(moved - joints, -_LARGEST_STEP, _LARGEST_STEP)
        joints = bounded(joints + step, lower, upper)
    return joints


def _linearised(frames: Frames, targets: FloatArray, chain: Chain) -> tuple[FloatArray, FloatArray]:
    """Return the Jacobian's rows (n, 3 or 6, dof) for the targets, and the error (n, 3 or 6)."""
    return chain.jacobian(frames)[:, : targets.shape[1]], pose_error(frames, targets)


def evaluate(targets: FloatArray, joints: FloatArray, chain: Chain) -> Solution:
    """Return the errors at joints (n, dof) with respect to targets (n, 3 or 6)."""
    error = pose_error(chain.frames(joints), targets)
    position, orientation = (np.linalg.norm(one, axis=1) for one in (error[:, :3], error[:, 3:]))
    return Solution(joints, position, orientation)


def nearest(arm: KinematicArm, targets: FloatArray, joints: FloatArray, chain: Chain) -> Solution:
    """Return the joints that bring the tool nearest to its targets (Levenberg-Marquardt).

    A joint at a limit that would move beyond it is excluded from the step. The solution is the
    nearest point in the neighbourhood of the start; away from joint limits it is the global one.

    :param arm: gives the limits.
    :param targets: (n, 3) or (n, 6).
    :param joints: (n, dof) to start from.
    :param chain: the arm's chain up to the tool that the targets refer to.
    """
    lower, upper = arm.joint_lower, arm.joint_upper
    joints = bounded(joints, lower, upper)
    # One damping per row, which `least_squares_step` broadcasts.
    damping: Any = np.full((len(joints), 1), _INITIAL)
    for _ in range(_ITERATIONS):
        jacobian, error = _linearised(chain.frames(joints), targets, chain)
        jacobian = np.ascontiguousarray(jacobian)  # the layout decides how products are rounded
        uphill = (jacobian * error[:, :, None]).sum(axis=1)
        stuck = ((joints <= lower) & (uphill < 0)) | ((joints >= upper) & (uphill > 0))
        step = least_squares_step(jacobian * ~stuck[:, None, :], error, damping)
        tried = bounded(joints + bounded(step, -_LARGEST_STEP, _LARGEST_STEP), lower, upper)
        tried_error = pose_error(chain.frames(tried), targets)
        square = np.square(error).sum(axis=1, keepdims=True)
        better = np.square(tried_error).sum(axis=1, keepdims=True) < square
        damping = bounded(damping * np.where(better, _BETTER, _WORSE), _LEAST, _MOST)
        moved = np.abs(np.where(better, tried - joints, 0.0)).max(initial=0.0)
        joints = np.where(better, tried, joints)
        settled = (damping >= _MOST) | (square < _EXACT)
        if settled.all() or (moved < _STILL and (better | settled).all()):
            break
    return evaluate(targets, joints, chain)


def reach(
    arm: KinematicArm, targets: FloatArray, present: FloatArray | None, chain: Chain
) -> Solution:
    """Solve inverse kinematics without a model.

    The search starts from the present joints. Without them it follows the straight line from the
    home posture to each target, so that neighbouring targets get neighbouring joints.

    :param arm: the arm.
    :param targets: (n, 3) or (n, 6), metres and radians.
    :param present: (n, dof), or None.
    :param chain: the arm's chain up to the tool that the targets refer to.
    """
    if present is not None:
        return nearest(arm, targets, present, chain)
    joints = np.tile(np.asarray(arm.robot.home), (len(targets), 1))
    start = np.zeros(targets.shape[1])
    start[:3] = chain.position(joints[:1])[0]
    for fraction in np.linspace(0, 1, 11)[1:]:
        joints = newton(arm, start + fraction * (targets - start), joints, 2, chain)
    found = evaluate(targets, newton(arm, targets, joints, 3, chain), chain)
    missed = ~found.reachable
    if not missed.any():
        return found
    found.joints[missed] = nearest(arm, targets[missed], found.joints[missed], chain).joints
    return evaluate(targets, found.joints, chain)
