"""Newton steps after a model's guess, compiled and arm by arm: fast enough for every control step.

`saver_envs.modelling.solvers` has the same steps in NumPy, for whole data sets, and is the
reference in the tests. For the few arms of a control step NumPy's overhead per call dominates, and
compiled code can call neither `saver_envs.control.least_squares_step` nor `Chain.frames`, so this
module implements both again.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from saver_envs.modelling.arms.description import KinematicArm
from saver_envs.modelling.chain import FloatArray
from saver_envs.modelling.compiled import compiled
from saver_envs.modelling.solvers import rotation_of

#: A refined guess with a larger error is discarded (m, rad).
POSITION_ENOUGH, ORIENTATION_ENOUGH = 0.008, 0.03
#: Errors this small need no further step (m, rad).
_EXACT = 1e-6
#: Largest step of a joint (rad, m).
_LARGEST_STEP = 0.3
#: A solution with a joint this far from its present value lies on another branch (rad, m): on the
#: way there the hand would leave its path.
_FAR = 0.6
#: Squared damping of steps after a guess, and of steps from the present joints, which may be near
#: singular postures.
_NEWTON_DAMPING, _PRESENT_DAMPING = 1e-7, 3e-4
#: Steps from the present joints in addition to the steps after a guess.
_FURTHER_STEPS = 1


class _Joints(NamedTuple):
    """Kinematics of an arm, one entry per joint; ``fixed`` (dof + 1, 3, 4) includes the tool.

    ``turn`` is a full turn for continuous joints, and 0 for others.
    """

    fixed: FloatArray
    lower: FloatArray
    upper: FloatArray
    home: FloatArray
    idle: NDArray[np.bool_]
    direction: FloatArray
    slides: NDArray[np.bool_]
    turn: FloatArray


class Refinement:
    """Refines guesses of joints for one arm.

    :param arm: gives kinematics, limits, and the joints that do not move the tool.
    """

    def __init__(self, arm: KinematicArm) -> None:
        chain = arm.tool_chain
        fixed = np.concatenate([chain.before, chain.tool[None]])
        fixed[1:] = chain.after @ fixed[1:]
        self._joints = _Joints(
            np.ascontiguousarray(fixed[:, :3]),
            arm.joint_lower,
            arm.joint_upper,
            np.asarray(arm.robot.home),
            np.isin(np.arange(arm.dof), arm.idle_joints),
            chain.direction,
            chain.prismatic,
            np.where(np.isfinite(arm.joint_lower), 0.0, 2 * np.pi),
        )

    def settled(self, guess: FloatArray, present: FloatArray, still: bool) -> FloatArray:
        """Return guesses (n, dof) within the limits, continuous joints nearest to the present.

        :param guess: (n, dof), metres and radians.
        :param present: (n, dof) present joints.
        :param still: whether joints that do not move the tool are at home.
        :raises ValueError: for mismatched shapes.
        """
        self._check(len(guess), guess=guess, present=present)
        settled = np.array(guess)
        for joints, now in zip(settled, present, strict=True):
            _settle(joints, now, self._joints, still)
        return settled

    def __call__(
        self, targets: FloatArray, guess: FloatArray, present: FloatArray, steps: int
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return joints, and which targets are missed by more than 8 mm or 30 mrad.

        A guess on another branch than the present joints', or one that the steps do not bring to
        its target, is replaced by damped steps from the present joints.

        :param targets: (n, 3) positions or (n, 6) poses, metres and radians.
        :param guess: (n, dof), metres and radians.
        :param present: (n, dof) present joints.
        :param steps: greatest number of steps after a guess.
        :return: (n, dof), within the joint limits, and (n,).
        :raises ValueError: for mismatched shapes.
        """
        self._check(len(targets), guess=guess, present=present)
        poses = targets.shape[1] == 6
        rotations = rotation_of(targets[:, 3:]) if poses else np.empty((len(targets), 3, 3))
        return _refine(targets, rotations, guess, present, self._joints, steps)

    def _check(self, n: int, **arrays: FloatArray) -> None:
        """Check shapes: compiled code does not notice that it reads beyond an array's end."""
        wanted = (n, len(self._joints.home))
        for name, values in arrays.items():
            if values.shape != wanted:
                raise ValueError(f"{name} of shape {values.shape}: must have shape {wanted}")


@compiled
def _refine(
    targets: FloatArray,
    rotations: FloatArray,
    guess: FloatArray,
    present: FloatArray,
    arm: _Joints,
    steps: int,
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return joints (n, dof), and which targets are missed (n,); see `Refinement.__call__`."""
    n = len(targets)
    joints, missed = np.empty((n, present.shape[1])), np.empty(n, dtype=np.bool_)
    for index in range(n):
        target, rotation, now = targets[index], rotations[index], present[index]
        best = joints[index]
        best[:] = guess[index]
        _settle(best, now, arm, True)
        near = (np.abs(best - now)[~arm.idle] <= _FAR).all()  # False for NaN
        reached = near and _approach(best, target, rotation, arm, steps, _NEWTON_DAMPING)
        if not reached:
            other = now.copy()
            _settle(other, now, arm, True)
            further = steps + _FURTHER_STEPS
            reached = _approach(other, target, rotation, arm, further, _PRESENT_DAMPING)
            # A distant solution is better than none nearby.
            distant = (not reached and not near) and _approach(
                best, target, rotation, arm, steps, _NEWTON_DAMPING
            )
            if not distant:
                best[:] = other
            reached = reached or distant
        missed[index] = not reached
    return joints, missed


@compiled
def _settle(joints: FloatArray, present: FloatArray, arm: _Joints, still: bool) -> None:
    """Move idle joints home, continuous joints near the present, and all within their limits."""
    for joint in range(len(joints)):
        if still and arm.idle[joint]:
            joints[joint] = arm.home[joint]
        elif arm.turn[joint] != 0.0:
            turns = np.rint((present[joint] - joints[joint]) / arm.turn[joint])
            joints[joint] += turns * arm.turn[joint]
        joints[joint] = min(max(joints[joint], arm.lower[joint]), arm.upper[joint])


@compiled
def _approach(
    joints: FloatArray,
    target: FloatArray,
    orientation: FloatArray,
    arm: _Joints,
    steps: int,
    damping: float,
) -> bool:
    """Make at most ``steps`` steps towards a target, in place; return whether it is reached."""
    for step in range(steps + 1):
        frame, axes, anchors = _forward(joints, arm)
        error = _pose_error(target, orientation, frame)
        if step == steps or np.abs(error).max() < _EXACT:
            break
        columns = _jacobian(frame[:, 3], axes, anchors, arm)
        _step(joints, arm, damping, columns, error)
    near = (np.abs(error[:3]) <= POSITION_ENOUGH).all()  # False for NaN
    return bool(near and (np.abs(error[3:]) <= ORIENTATION_ENOUGH).all())


@compiled
def _forward(joints: FloatArray, arm: _Joints) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the tool's frame (3, 4), and the joints' axes and anchors (dof, 3)."""
    dof = len(joints)
    frame, axes, anchors = np.eye(3, 4), np.empty((dof, 3)), np.empty((dof, 3))
    for joint in range(dof + 1):
        link = arm.fixed[joint]
        sine, cosine, slide, direction = 0.0, 1.0, 0.0, 1.0
        if joint < dof:
            direction = arm.direction[joint]
            move = joints[joint] * direction
            if arm.slides[joint]:
                slide = move
            else:
                sine, cosine = np.sin(move), np.cos(move)
        for row in range(3):
            x, y, z = frame[row, 0], frame[row, 1], frame[row, 2]
            frame[row, 3] += x * link[0, 3] + y * link[1, 3] + z * link[2, 3]
            u = x * link[0, 0] + y * link[1, 0] + z * link[2, 0]
            v = x * link[0, 1] + y * link[1, 1] + z * link[2, 1]
            w = x * link[0, 2] + y * link[1, 2] + z * link[2, 2]
            frame[row, 0], frame[row, 1] = cosine * u + sine * v, cosine * v - sine * u
            frame[row, 2] = w
            if joint < dof:
                axes[joint, row] = w * direction
                anchors[joint, row] = frame[row, 3]
                frame[row, 3] += w * slide
    return frame, axes, anchors


@compiled
def _pose_error(target: FloatArray, orientation: FloatArray, frame: FloatArray) -> FloatArray:
    """Return the tool's error (3,) or (6,) as `solvers.pose_error` defines it."""
    error = np.zeros(len(target))
    error[:3] = target[:3] - frame[:, 3]
    if len(error) == 6:
        for axis in range(3):
            error[3:] += 0.5 * np.cross(frame[:, axis], orientation[:, axis])
    return error


@compiled
def _jacobian(tool: FloatArray, axes: FloatArray, anchors: FloatArray, arm: _Joints) -> FloatArray:
    """Return the Jacobian's columns (dof, 6), linear before angular."""
    columns = np.zeros((len(axes), 6))
    for joint in range(len(axes)):
        if arm.slides[joint]:
            columns[joint, :3] = axes[joint]
            continue
        columns[joint, 3:] = axes[joint]
        columns[joint, :3] = np.cross(axes[joint], tool - anchors[joint])
    return columns


@compiled
def _step(
    joints: FloatArray, arm: _Joints, damping: float, columns: FloatArray, error: FloatArray
) -> None:
    """Make a damped least squares step, in place; joints that would leave their limits stay."""
    step = _least_squares(damping, columns, error)
    moved = joints + step
    beyond = (moved < arm.lower) | (moved > arm.upper)
    if beyond.any():
        columns[beyond] = 0.0
        step = _least_squares(damping, columns, error)
    moved = joints + np.minimum(np.maximum(step, -_LARGEST_STEP), _LARGEST_STEP)
    joints[:] = np.minimum(np.maximum(moved, arm.lower), arm.upper)


@compiled
def _least_squares(damping: float, columns: FloatArray, error: FloatArray) -> FloatArray:
    """Return J^T (J J^T + damping I)^-1 error, by Cholesky's decomposition."""
    rows, dof = len(error), len(columns)
    gram, solution, step = np.empty((rows, rows)), np.empty(rows), np.zeros(dof)
    for row in range(rows):
        for other in range(row + 1):
            total = damping if row == other else 0.0
            for joint in range(dof):
                total += columns[joint, row] * columns[joint, other]
            for k in range(other):
                total -= gram[row, k] * gram[other, k]
            gram[row, other] = np.sqrt(total) if row == other else total / gram[other, other]
        total = error[row]
        for k in range(row):
            total -= gram[row, k] * solution[k]
        solution[row] = total / gram[row, row]
    for row in range(rows - 1, -1, -1):
        for k in range(row + 1, rows):
            solution[row] -= gram[k, row] * solution[k]
        solution[row] /= gram[row, row]
    for row in range(rows):
        step += columns[:, row] * solution[row]
    return step
