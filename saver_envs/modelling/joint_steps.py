"""Joint steps for many configurations at once, kept in columns: Newton's, and a short search."""

from __future__ import annotations

from contextlib import suppress
from functools import cache

import numpy as np
from numpy.typing import NDArray

from saver_envs.control import bounded, least_squares_step
from saver_envs.modelling.chain import FloatArray
from saver_envs.modelling.multilinear import MultilinearTool

Float32 = NDArray[np.float32]
#: Three columns of three entries lie end to end. The products of the first two choices less those
#: of the last two are the cross products b x c, c x a and a x b of columns a, b and c.
_CHOICES = tuple(
    np.array(
        [
            3 * ((column + shift) % 3) + (entry + turn) % 3
            for column in range(3)
            for entry in range(3)
        ]
    )
    for shift, turn in ((1, 1), (2, 2), (1, 2), (2, 1))
)
#: Systems up to which LAPACK is quicker than an elimination of all at once.
_FEW = 128
#: Volumes (m^3) and squared damping next to nothing.
_LEAST_VOLUME, _DAMPING = 1e-9, 1e-7


def newton_step(jacobian: FloatArray, error: FloatArray) -> FloatArray:
    """Return the joint step (dof, n) that removes an error to first order.

    As many joints as rows are solved for directly, three of them by Cramer's rule; otherwise it is
    the shortest step. It is exact to about a thousandth. Near singular postures it is long, and in
    singular ones it may not be finite.

    :param jacobian: (n, rows, dof).
    :param error: (rows, n), metres and radians.
    """
    rows, dof = jacobian.shape[1:]
    if rows != dof:
        return least_squares_step(jacobian, error.T, _DAMPING).T
    if rows == 3:
        return _by_cramers_rule(jacobian, error)
    if len(jacobian) <= _FEW:
        # One call for each system, where elimination is some fifty for all of them.
        with suppress(np.linalg.LinAlgError):
            columns = np.linalg.solve(jacobian, error.T[..., None])[..., 0].T
            return np.asarray(columns, np.float64)
    return _by_elimination(jacobian, error)


def _by_elimination(jacobian: FloatArray, error: FloatArray) -> FloatArray:
    """Gaussian elimination of all systems at once, without a search for pivots."""
    n, size = jacobian.shape[:2]
    rows = np.empty((size, size + 1, n), np.float32)
    rows[:, :size], rows[:, size] = jacobian.transpose(1, 2, 0), error
    rows = (_mixing(size) @ rows.reshape(size, -1)).reshape(rows.shape)
    with np.errstate(all="ignore"):
        for k in range(size - 1):
            pivot_row = rows[k, k + 1 :]
            pivot_row /= rows[k, k]
            rows[k + 1 :, k + 1 :] -= rows[k + 1 :, k, None] * pivot_row
        step = np.empty((size, n), np.float32)
        step[-1] = rows[-1, size] / rows[-1, size - 1]
        for k in range(size - 2, -1, -1):
            known = np.add.reduce(rows[k, k + 1 : size] * step[k + 1 :])
            step[k] = rows[k, size] - known
    return step.astype(np.float64)


@cache
def _mixing(size: int) -> Float32:
    """A rotation, the same at every call, that mixes a system's rows.

    Behind it no leading block is singular but by chance: pivots need not be searched for (random
    butterfly transforms, Parker, 1995).
    """
    random = np.random.default_rng(0).standard_normal((size, size))
    return np.linalg.qr(random)[0].astype(np.float32)


def _by_cramers_rule(jacobian: FloatArray, error: FloatArray) -> FloatArray:
    columns = np.ascontiguousarray(jacobian.transpose(2, 1, 0)).reshape(9, -1)
    a, b, c, d = (columns.take(index, 0) for index in _CHOICES)
    crossed = (a * b - c * d).reshape(3, 3, -1)
    volume = np.add.reduce(columns[:3] * crossed[0])
    volume = np.where(np.abs(volume) < _LEAST_VOLUME, _LEAST_VOLUME, volume)
    return np.add.reduce(crossed * error, axis=1) / volume


#: Squared damping of a search: first, and its changes after a good and a bad step.
_FIRST, _BETTER, _WORSE = 1e-4, 0.3, 4.0
#: Longest step of a joint in a search (rad, m).
_LONGEST = 0.3


def search(
    tool: MultilinearTool,
    wanted: FloatArray,
    joints: FloatArray,
    limits: tuple[FloatArray, FloatArray],
    enough: FloatArray,
    steps: int,
) -> tuple[FloatArray, FloatArray]:
    """Come nearer to targets by some steps in Levenberg's and Marquardt's way.

    :param tool: the arm's.
    :param wanted: (rows, n) targets.
    :param joints: (dof, n) to start from, within the limits.
    :param limits: lower and upper (dof, 1). A joint at one that would go beyond is left out.
    :param enough: (rows, 1) errors at which a column is done.
    :param steps: their greatest number.
    :return: joints (dof, n), each column the best that it came by, and their errors (rows, n).
    """
    features = tool.features(joints)
    error = wanted - tool.pose(features)
    cost, damping = np.square(error).sum(axis=0), np.full(joints.shape[1], _FIRST)
    for _ in range(steps):
        if not (np.abs(error) > enough).any():
            break
        step = _damped_step(tool.jacobian(features), error, damping, joints, limits)
        tried = bounded(joints + bounded(step, -_LONGEST, _LONGEST), *limits)
        tried_features = tool.features(tried)
        tried_error = wanted - tool.pose(tried_features)
        tried_cost = np.square(tried_error).sum(axis=0)
        better = tried_cost < cost
        damping = damping * np.where(better, _BETTER, _WORSE)
        cost = np.where(better, tried_cost, cost)
        joints, error = np.where(better, tried, joints), np.where(better, tried_error, error)
        features = np.where(better, tried_features, features)
    return joints, error


def _damped_step(
    jacobian: Float32,
    error: FloatArray,
    damping: FloatArray,
    joints: FloatArray,
    limits: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """Damped least squares (dof, n) with a damping for each column (rows, dof, n)."""
    uphill = (jacobian * error[:, None]).sum(axis=0)
    stuck = ((joints <= limits[0]) & (uphill < 0)) | ((joints >= limits[1]) & (uphill > 0))
    matrix = (jacobian * ~stuck).transpose(2, 0, 1).astype(np.float64)
    transposed = matrix.swapaxes(-1, -2)
    gram = matrix @ transposed + damping[:, None, None] * np.eye(len(error))
    return (transposed @ np.linalg.solve(gram, error.T[..., None]))[..., 0].T
