"""Small vector helpers of the experts, over leading dimensions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating]


def dot(first: FloatArray, second: FloatArray) -> FloatArray:
    """Scalar products over the last axis."""
    return np.sum(first * second, axis=-1)


def length(vectors: FloatArray) -> FloatArray:
    """Lengths over the last axis."""
    return np.sqrt(dot(vectors, vectors))


def unit(vectors: FloatArray) -> FloatArray:
    """Vectors of length 1 in the same directions; zero stays zero."""
    return vectors / np.maximum(length(vectors), 1e-6)[..., None]
