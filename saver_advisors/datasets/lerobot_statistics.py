"""Statistics of a feature as LeRobot's data sets keep them, for normalisation."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

QUANTILES: Final = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
"""Names of the quantiles."""
LEVELS: Final = 256
"""Values of a pixel."""

Statistics = dict[str, list[Any]]
"""``min``, ``max``, ``mean``, ``std``, ``count`` and the quantiles, as nested lists."""


def vector_statistics(values: NDArray[Any]) -> Statistics:
    """Compute the statistics of vectors, each of their numbers by itself.

    :param values: (frames, size)
    :return: lists of ``size`` numbers; ``count`` is the number of frames
    """
    exact = values.astype(np.float64)
    found = {
        "min": exact.min(axis=0),
        "max": exact.max(axis=0),
        "mean": exact.mean(axis=0),
        "std": exact.std(axis=0),
    }
    quantiles = np.quantile(exact, list(QUANTILES.values()), axis=0)
    found |= dict(zip(QUANTILES, quantiles, strict=True))
    return {name: one.tolist() for name, one in found.items()} | {"count": [len(values)]}


def histogram(frame: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Count the values of a picture (height, width, 3).

    :return: (3, :data:`LEVELS`)
    """
    return np.stack(
        [np.bincount(frame[..., channel].ravel(), minlength=LEVELS) for channel in range(3)]
    )


def picture_statistics(counts: NDArray[np.int64], frames: int) -> Statistics:
    """Compute the statistics of pictures, each of their channels by itself, with pixels in [0, 1].

    :param counts: (3, :data:`LEVELS`), the sum of their histograms
    :param frames: number of pictures
    :return: nested lists of shape (3, 1, 1); ``count`` is the number of frames
    """
    levels = np.arange(LEVELS) / (LEVELS - 1)
    share = counts / counts.sum(axis=1, keepdims=True)
    mean = share @ levels
    spread = (share * (levels - mean[:, None]) ** 2).sum(axis=1)
    found = {
        "min": levels[(counts > 0).argmax(axis=1)],
        "max": levels[LEVELS - 1 - (counts > 0)[:, ::-1].argmax(axis=1)],
        "mean": mean,
        "std": np.sqrt(spread),
    }
    # In whole numbers: a sum of shares may be just below the quantile that it equals.
    below, total = counts.cumsum(axis=1), counts.sum(axis=1, keepdims=True)
    for name, quantile in QUANTILES.items():
        found[name] = levels[(below >= quantile * total).argmax(axis=1)]
    shaped = {name: one.reshape(3, 1, 1).tolist() for name, one in found.items()}
    return {**shaped, "count": [frames]}
