"""Small vector helpers of the experts, over leading dimensions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Air is wanted around an obstacle: who is too near leaves it at this angle per relative intrusion.
_OUTWARD = 2.0
#: Largest radius of an obstacle as a share of its distance from where one wants to go.
_COVER = 0.95

FloatArray = NDArray[np.floating]


def dot(first: FloatArray, second: FloatArray) -> FloatArray:
    """Scalar products over the last axis, of few numbers each."""
    products = first * second
    total = products[..., 0]
    # For many vectors, NumPy's sum over a short last axis takes ten times as long.
    for index in range(1, products.shape[-1]):
        total = total + products[..., index]
    return total


def length(vectors: FloatArray) -> FloatArray:
    """Lengths over the last axis."""
    return np.sqrt(dot(vectors, vectors))


def unit(vectors: FloatArray) -> FloatArray:
    """Vectors of length 1 in the same directions; zero stays zero."""
    return vectors / np.maximum(length(vectors), 1e-6)[..., None]


def rotated(vectors: FloatArray, angle: FloatArray) -> FloatArray:
    """Vectors (..., 2) turned anticlockwise by angles (...), radians."""
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)


def wrapped(angle: FloatArray) -> FloatArray:
    """Angles in [-pi, pi), radians."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def way_round(
    gap: FloatArray, discs: FloatArray, radius: FloatArray, side: FloatArray
) -> FloatArray:
    """Turn the way to a point so that it passes beside discs.

    Discs that overlap are passed as one, since turning past one is repeated for the others.

    :param gap: (..., 2) from here to the point, metres.
    :param discs: (..., k, 2) from here to the discs' centres, metres.
    :param radius: (..., k) of the discs, metres.
    :param side: (...) 1 passes them anticlockwise, as seen from them, -1 clockwise, 0 where the
        detour is shorter.
    :return: (..., 2) a unit vector along which to start.
    """
    goal = np.arctan2(gap[..., 1], gap[..., 0])
    # A disc never covers the point.
    radius = np.minimum(radius, _COVER * length(discs - gap[..., None, :]))
    distance, far = np.maximum(length(discs), 1e-6), length(gap)
    bearing = wrapped(np.arctan2(discs[..., 1], discs[..., 0]) - goal[..., None])
    share = radius / distance
    half = np.arcsin(np.minimum(share, 1.0))
    half = half + _OUTWARD * np.maximum(share - 1.0, 0.0)
    # Only a disc that begins before the point is in the way.
    within = np.sqrt(np.maximum(distance**2 - np.minimum(radius, distance) ** 2, 0.0))
    near = within < far[..., None]
    turn = np.zeros((2, *goal.shape))
    for index, sign in enumerate((-1.0, 1.0)):
        for _ in range(discs.shape[-2]):
            off = wrapped(bearing - turn[index][..., None])
            blocks = near & (np.abs(off) < half - 1e-9)
            more = np.where(blocks, off + sign * half, 0.0)
            turn[index] += sign * np.max(sign * more, axis=-1, initial=0.0)
    # To turn right is to pass anticlockwise.
    right = np.where(side == 0, -turn[0] <= turn[1], side > 0)
    angle = goal + np.where(right, turn[0], turn[1])
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)
