"""Newton steps behind a model's guess, arm by arm in compiled code: cheap enough for every step.

`saver_envs.modelling.solvers` has the same for whole data sets, where time is of no account.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from saver_envs.modelling.arms import Arm
from saver_envs.modelling.chain import FloatArray
from saver_envs.modelling.compiled import compiled

#: Larger errors of a refined guess get another way to the target (m, rad).
POSITION_ENOUGH, ORIENTATION_ENOUGH = 0.008, 0.03
#: Errors this small need no further step (m, rad).
_EXACT = 1e-6
#: Longest step of a joint (rad, m).
_LONGEST_STEP = 0.3
#: A solution with a joint this far from where it is lies on another branch (rad, m): on the way
#: there the hand would leave its path.
_FAR = 0.6
#: Squared damping of steps behind a guess, and of those from the present joints, which may be near
#: singular postures.
_NEWTON_DAMPING, _PRESENT_DAMPING = 1e-7, 3e-4
#: Steps from the present joints beyond those behind a guess.
_FURTHER_STEPS = 1
#: Rows of the table of joints.
_LOWER, _UPPER, _HOME, _IDLE, _DIRECTION, _SLIDES, _TURN = range(7)


class Refinement:
    """Guesses brought to their targets, for one arm's kinematics.

    :param arm: gives kinematics, limits, and which joints do not move the tool.
    """

    def __init__(self, arm: Arm) -> None:
        chain = arm.tool_chain
        fixed = np.concatenate([chain.before, chain.tool[None]])
        fixed[1:] = chain.after @ fixed[1:]
        self._fixed = np.ascontiguousarray(fixed[:, :3])
        idle = np.isin(np.arange(arm.dof), arm.idle_joints)
        endless = ~np.isfinite(arm.joint_lower)
        self._table = np.array(
            [
                arm.joint_lower,
                arm.joint_upper,
                np.asarray(arm.robot.home),
                idle,
                chain.direction,
                chain.prismatic,
                np.where(endless, 2 * np.pi, 0.0),
            ]
        )

    def settled(self, guess: FloatArray, present: FloatArray, still: bool) -> FloatArray:
        """Return guesses (n, dof) within the limits, endless joints nearest to the present.

        :param guess: (n, dof), metres and radians.
        :param present: (n, dof), the joints now.
        :param still: whether joints that do not move the tool are at home.
        :raises ValueError: for shapes that do not belong together.
        """
        self._check(len(guess), guess=guess, present=present)
        settled = np.array(guess)
        _settle_all(settled, present, self._table, still)
        return settled

    def __call__(
        self, targets: FloatArray, guess: FloatArray, present: FloatArray, steps: int
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return joints, and which targets are missed by more than 8 mm or 30 mrad.

        Guesses on another branch than that of the present joints, and those that the steps do not
        bring to their targets, make way for damped steps from the present joints.

        :param targets: (n, 3) positions or (n, 6) poses, metres and radians.
        :param guess: (n, dof), metres and radians.
        :param present: (n, dof), the joints now.
        :param steps: at most so many behind a guess.
        :return: (n, dof), within the joint limits, and (n,).
        :raises ValueError: for shapes that do not belong together.
        """
        self._check(len(targets), guess=guess, present=present)
        joints = np.empty_like(present)
        missed = np.empty(len(targets), dtype=np.bool_)
        _refine(targets, guess, present, self._fixed, self._table, steps, joints, missed)
        return joints, missed

    def _check(self, n: int, **arrays: FloatArray) -> None:
        """Compiled code reads on past an array's end: nothing else would notice."""
        wanted = (n, self._table.shape[1])
        for name, values in arrays.items():
            if values.shape != wanted:
                raise ValueError(f"{name} of shape {values.shape}: must have shape {wanted}")


@compiled
def _refine(
    targets: FloatArray,
    guess: FloatArray,
    present: FloatArray,
    fixed: FloatArray,
    table: FloatArray,
    steps: int,
    joints: FloatArray,
    missed: NDArray[np.bool_],
) -> None:
    rows, dof = targets.shape[1], present.shape[1]
    other = np.empty(dof)
    orientation = np.empty((3, 3))
    scratch = (np.empty((3, 4)), np.empty((dof, 6)), np.empty((dof, 3)), np.empty(rows))
    system = (np.empty((rows, rows)), np.empty(rows), np.empty(dof))
    for arm in range(len(targets)):
        target, now, best = targets[arm], present[arm], joints[arm]
        _orientation(target, orientation)
        best[:] = guess[arm]
        _settle(best, now, table, True)
        near = _way(best, now, table) <= _FAR
        guessed = steps, _NEWTON_DAMPING
        reached = near and _approach(
            best, target, orientation, fixed, table, guessed, scratch, system
        )
        if not reached:
            other[:] = now
            _settle(other, now, table, True)
            direct = steps + _FURTHER_STEPS, _PRESENT_DAMPING
            reached = _approach(other, target, orientation, fixed, table, direct, scratch, system)
            # A long way that leads there is better than a short one that does not.
            by_far = (not reached and not near) and _approach(
                best, target, orientation, fixed, table, guessed, scratch, system
            )
            if not by_far:
                best[:] = other
            reached = reached or by_far
        missed[arm] = not reached


@compiled
def _settle_all(joints: FloatArray, present: FloatArray, table: FloatArray, still: bool) -> None:
    for arm in range(len(joints)):
        _settle(joints[arm], present[arm], table, still)


@compiled
def _settle(joints: FloatArray, present: FloatArray, table: FloatArray, still: bool) -> None:
    for joint in range(len(joints)):
        if still and table[_IDLE, joint] != 0.0:
            joints[joint] = table[_HOME, joint]
        elif table[_TURN, joint] != 0.0:
            turns = np.rint((present[joint] - joints[joint]) / table[_TURN, joint])
            joints[joint] += turns * table[_TURN, joint]
        joints[joint] = min(max(joints[joint], table[_LOWER, joint]), table[_UPPER, joint])


@compiled
def _way(joints: FloatArray, present: FloatArray, table: FloatArray) -> float:
    """The longest way of a joint that moves the tool; infinite where it is no number."""
    longest = 0.0
    for joint in range(len(joints)):
        if table[_IDLE, joint] == 0.0:
            way = abs(joints[joint] - present[joint])
            longest = max(longest, way if way == way else np.inf)
    return longest


@compiled
def _approach(
    joints: FloatArray,
    target: FloatArray,
    orientation: FloatArray,
    fixed: FloatArray,
    table: FloatArray,
    effort: tuple[int, float],
    scratch: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    system: tuple[FloatArray, FloatArray, FloatArray],
) -> bool:
    """Step towards a target, in place; say whether it is reached.

    Effort is the greatest number of steps, and their squared damping.
    """
    steps, damping = effort
    frame, columns, anchor, error = scratch
    for step in range(steps + 1):
        _forward(joints, fixed, table, frame, columns, anchor)
        worst = _lack(frame, target, orientation, error)
        if step == steps or worst < _EXACT:
            break
        _jacobian(frame, table, columns, anchor)
        _step(joints, error, table, columns, damping, system)
    reached = True
    for row in range(len(error)):
        enough = POSITION_ENOUGH if row < 3 else ORIENTATION_ENOUGH
        # An error that is no number is not enough.
        reached = reached and abs(error[row]) <= enough
    return reached


@compiled
def _forward(
    joints: FloatArray,
    fixed: FloatArray,
    table: FloatArray,
    frame: FloatArray,
    columns: FloatArray,
    anchor: FloatArray,
) -> None:
    """Write the tool's frame (3, 4) and the joints' axes, into columns[:, 3:], and anchors."""
    dof = len(joints)
    for row in range(3):
        for column in range(4):
            frame[row, column] = 1.0 if row == column else 0.0
    for joint in range(dof + 1):
        link = fixed[joint]
        sine, cosine, slide, direction = 0.0, 1.0, 0.0, 1.0
        if joint < dof:
            direction = table[_DIRECTION, joint]
            move = joints[joint] * direction
            if table[_SLIDES, joint] != 0.0:
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
                columns[joint, 3 + row] = w * direction
                anchor[joint, row] = frame[row, 3]
                frame[row, 3] += w * slide


@compiled
def _jacobian(
    frame: FloatArray, table: FloatArray, columns: FloatArray, anchor: FloatArray
) -> None:
    """Complete the Jacobian's columns (dof, 6), linear before angular, where the axes are."""
    for joint in range(len(columns)):
        x, y, z = columns[joint, 3], columns[joint, 4], columns[joint, 5]
        if table[_SLIDES, joint] != 0.0:
            columns[joint, 0], columns[joint, 1], columns[joint, 2] = x, y, z
            columns[joint, 3:] = 0.0
            continue
        u = frame[0, 3] - anchor[joint, 0]
        v = frame[1, 3] - anchor[joint, 1]
        w = frame[2, 3] - anchor[joint, 2]
        columns[joint, 0] = y * w - z * v
        columns[joint, 1] = z * u - x * w
        columns[joint, 2] = x * v - y * u


@compiled
def _lack(
    frame: FloatArray, target: FloatArray, orientation: FloatArray, error: FloatArray
) -> float:
    """Write what the tool lacks, as `solvers.pose_error` has it; return the greatest entry."""
    for row in range(3):
        error[row] = target[row] - frame[row, 3]
    if len(error) == 6:
        for row in range(3):
            a, b = (row + 1) % 3, (row + 2) % 3
            turn = 0.0
            for k in range(3):
                turn += frame[a, k] * orientation[b, k] - frame[b, k] * orientation[a, k]
            error[3 + row] = 0.5 * turn
    worst = 0.0
    for row in range(len(error)):
        worst = max(worst, abs(error[row]))
    return worst


@compiled
def _orientation(target: FloatArray, orientation: FloatArray) -> None:
    """Write the rotation matrix of a pose's rotation vector (Rodrigues)."""
    for row in range(3):
        for column in range(3):
            orientation[row, column] = 1.0 if row == column else 0.0
    if len(target) < 6:
        return
    x, y, z = target[3], target[4], target[5]
    angle = np.sqrt(x * x + y * y + z * z)
    if angle < 1e-12:
        return
    x, y, z = x / angle, y / angle, z / angle
    sine, rest = np.sin(angle), 1.0 - np.cos(angle)
    orientation[0, 0] -= rest * (y * y + z * z)
    orientation[1, 1] -= rest * (x * x + z * z)
    orientation[2, 2] -= rest * (x * x + y * y)
    orientation[0, 1], orientation[1, 0] = rest * x * y - sine * z, rest * x * y + sine * z
    orientation[0, 2], orientation[2, 0] = rest * x * z + sine * y, rest * x * z - sine * y
    orientation[1, 2], orientation[2, 1] = rest * y * z - sine * x, rest * y * z + sine * x


@compiled
def _step(
    joints: FloatArray,
    error: FloatArray,
    table: FloatArray,
    columns: FloatArray,
    damping: float,
    system: tuple[FloatArray, FloatArray, FloatArray],
) -> None:
    """Make a damped least squares step, in place.

    Joints that it would take beyond a limit stay, and the others do without them.
    """
    gram, solution, step = system
    _least_squares(error, columns, damping, gram, solution, step)
    beyond = False
    for joint in range(len(joints)):
        moved = joints[joint] + step[joint]
        if moved < table[_LOWER, joint] or moved > table[_UPPER, joint]:
            columns[joint] = 0.0
            beyond = True
    if beyond:
        _least_squares(error, columns, damping, gram, solution, step)
    for joint in range(len(joints)):
        moved = joints[joint] + min(max(step[joint], -_LONGEST_STEP), _LONGEST_STEP)
        joints[joint] = min(max(moved, table[_LOWER, joint]), table[_UPPER, joint])


@compiled
def _least_squares(
    error: FloatArray,
    columns: FloatArray,
    damping: float,
    gram: FloatArray,
    solution: FloatArray,
    step: FloatArray,
) -> None:
    """Write J^T (J J^T + damping I)^-1 error, by Cholesky's decomposition."""
    rows, dof = len(error), len(columns)
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
    for joint in range(dof):
        step[joint] = 0.0
        for row in range(rows):
            step[joint] += columns[joint, row] * solution[row]
