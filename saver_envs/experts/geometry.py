"""Small vector helpers of the experts, over leading dimensions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from saver_envs.control import length

FloatArray = NDArray[np.floating]


def dot(first: FloatArray, second: FloatArray) -> FloatArray:
    """Scalar products over the last axis."""
    return np.sum(first * second, axis=-1)


def unit(vectors: FloatArray) -> FloatArray:
    """Vectors of length 1 in the same directions; zero stays zero."""
    return vectors / np.maximum(length(vectors), 1e-6)[..., None]
