"""A chain's forward map as two matrix products: for a few hundred configurations in a few calls.

The transform of a hinge is affine in the cosine and sine of its angle, that of a slide in its
length. The tool's pose is therefore multilinear in the features (1, cos q, sin q), or (1, q, 0), of
the joints: a constant matrix times all products of one feature a joint. The chain is split in two
halves, so that there are at most 81 products of each instead of 6,561, and the halves' poses are
multiplied. The same map with the derivative of one joint's features gives a column of the Jacobian.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from saver_envs.modelling.chain import Chain, FloatArray

Float32 = NDArray[np.float32]
#: Features of a joint.
_FEATURES = 3


class MultilinearTool:
    """Where a tool is, for configurations in columns.

    What `solvers.pose_error` gives is the target less this. Computed in float32: exact to a
    micrometre.

    :param chain: the arm's, of the tool that the targets are meant for.
    :param rows: 3 for positions, 6 for poses near tool-down.
    :raises ValueError: for another number of rows.
    """

    def __init__(self, chain: Chain, rows: int) -> None:
        if rows not in (3, 6):
            raise ValueError(f"rows={rows!r}: must be 3 or 6")
        self._rows, self._dof = rows, chain.dof
        self._prismatic = np.flatnonzero(chain.prismatic)
        self._direction = chain.direction.astype(np.float32)[:, None]
        terms = _terms(chain)
        half = (chain.dof + 1) // 2
        tables, self._second = _maps(
            _products(terms[:half]), _products(terms[half:]) @ chain.tool, rows
        )
        self._half, self._first = half, tables.reshape(-1, tables.shape[-1])

    def features(self, joints: FloatArray) -> Float32:
        """Return (3, dof, n) for joints (dof, n), radians and metres."""
        features = np.empty((_FEATURES, *joints.shape), np.float32)
        moves = np.multiply(joints, self._direction, out=features[1], casting="same_kind")
        np.sin(moves, out=features[2])
        slides = moves[self._prismatic] if self._prismatic.size else None
        np.cos(moves, out=moves)
        features[0] = 1.0
        if slides is not None:
            features[1, self._prismatic], features[2, self._prismatic] = slides, 0.0
        return features

    def pose(self, features: Float32) -> Float32:
        """Return (rows, n): position in metres, and for poses the turn from tool-down in radians.

        The turn is exact to first order, as that of `control.orientation_error`.

        :param features: see :meth:`features`.
        """
        first = self._first @ _all_products(features[:, : self._half])
        second = self._second @ _all_products(features[:, self._half :])
        shape = (self._rows, len(second), -1)
        return np.add.reduce(first.reshape(shape) * second, axis=1)

    def jacobian(self, features: Float32) -> Float32:
        """Return (rows, dof, n): derivatives of :meth:`pose` by the joints."""
        dof, n = self._dof, features.shape[-1]
        changed = np.repeat(features[:, :, None], dof, axis=2)  # (3, dof, by which joint, n)
        own = np.arange(dof)
        changed[0, own, own] = 0.0
        changed[1, own, own] = -features[2]
        changed[2, own, own] = features[1]
        for slide in self._prismatic:
            changed[:, slide, slide] = np.array([0, 1, 0], np.float32)[:, None]
        result = self.pose(changed.reshape(_FEATURES, dof, dof * n)).reshape(self._rows, dof, n)
        return result * self._direction


def _all_products(features: Float32) -> Float32:
    """All products (3^dof, n) of one feature of each joint: (3, dof, n)."""
    products = features[:, 0]
    n = features.shape[-1]
    for joint in range(1, features.shape[1]):
        products = (products[:, None] * features[:, joint]).reshape(-1, n)
    return products


def _terms(chain: Chain) -> FloatArray:
    """(dof, 3, 4, 4): the transform from link to link is the sum of features times these."""
    parts = np.zeros((chain.dof, _FEATURES, 4, 4))
    for joint, slides in enumerate(chain.prismatic):
        constant, first, second = parts[joint]
        if slides:
            constant[:] = np.eye(4)
            first[2, 3] = 1.0
        else:
            constant[2, 2] = constant[3, 3] = 1.0
            first[0, 0] = first[1, 1] = 1.0
            second[1, 0], second[0, 1] = 1.0, -1.0
    return chain.before[:, None] @ parts @ chain.after[:, None]


def _products(terms: FloatArray) -> FloatArray:
    """(3^joints, 4, 4): the matrix that belongs to each product of features."""
    found = np.eye(4)[None]
    for joint in terms:
        found = (found[:, None] @ joint[None]).reshape(-1, 4, 4)
    return found


def _maps(first: FloatArray, second: FloatArray, rows: int) -> tuple[Float32, Float32]:
    """Maps from the products of the halves to two tables whose product's sum is the pose.

    :param first: (products, 4, 4) of the first half.
    :param second: (products, 4, 4) of the second.
    :param rows: of the pose.
    :return: (rows, entries, products) and (entries, products), entries being those of the second
        half's transform that the pose depends on.
    """
    table = np.zeros((rows, 4, 4, len(first)))
    for row in range(3):  # position: the last column of the product
        table[row, :, 3] = first[:, row].T
    for row, (a, b) in enumerate(((1, 2), (2, 0), (0, 1))[: rows - 3]):
        table[3 + row, :, b] -= 0.5 * first[:, a].T
        table[3 + row, :, a] += 0.5 * first[:, b].T
    used = np.any(table != 0, axis=(0, 3)) & np.any(second != 0, axis=0)
    return (
        np.ascontiguousarray(table[:, used], dtype=np.float32),
        np.ascontiguousarray(second[:, used].T, dtype=np.float32),
    )
