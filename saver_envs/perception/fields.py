"""Encode people as bipolar heat maps and part affinity fields (eq. 4.4 to 4.6).

Points are continuous picture coordinates in pixels: (0, 0) is the corner at the top left, the
centre of the first pixel is at (0.5, 0.5). In a picture of half the size, a point has half the
coordinates, and the centre of cell (row, column) of a field of stride 8 is at
(8 (column + 1/2), 8 (row + 1/2)).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from saver_envs.perception.skeleton import LIMBS

#: Pixels of the picture per cell of a field, along both axes (SPEC 5.2).
STRIDE: Final = 8
#: Channels of a limb: affinity along x, affinity along y, heat.
AFFINITY_X, AFFINITY_Y, HEAT, N_CHANNELS = 0, 1, 2, 3
#: Smallest value of a Gaussian that is drawn.
_FAINTEST: Final = 1e-4
#: Sigma of exp(-d^2 / sigma^2), equation 4.4, and half the width of a limb's band, equation 4.5, in
#: cells. The paper gives no numbers. A peak of this width covers the 3 x 3 cells from which its
#: position between cells is computed, and joints 3 cells apart stay separate.
SIGMA: Final = 1.2
HALF_WIDTH: Final = 1.0


def encode(
    joints: NDArray[np.floating],
    annotated: NDArray[np.bool_],
    size: tuple[int, int],
    limbs: Sequence[int],
) -> NDArray[np.float32]:
    """Draw the fields of all people in a picture.

    Where bands of several people overlap, their directions are averaged over those people. The
    count of equation 4.6 is taken cell by cell: a count over the picture would weaken a limb
    because of another limb elsewhere.

    :param joints: (people, 14, 2) pixels of the picture; joints may be outside the picture.
    :param annotated: (people, 14) whether the position is known. A limb is drawn if both its joints
        are known, a peak if its joint is.
    :param size: height and width of the picture in pixels, multiples of 8.
    :param limbs: indices into :data:`~.skeleton.LIMBS`.
    :return: (limbs, 3, height / 8, width / 8): affinity x, affinity y, heat. The heat is +1 at
        proximal and -1 at distal joints.
    :raises ValueError: for a size that is no multiple of 8.
    """
    height, width = size
    if height % STRIDE or width % STRIDE:
        raise ValueError(f"size={size}: height and width must be multiples of {STRIDE}")
    x, y = np.arange(width // STRIDE), np.arange(height // STRIDE)
    fields = np.zeros((len(limbs), N_CHANNELS, len(y), len(x)), dtype=np.float32)
    if len(joints) == 0:
        return fields
    cells = np.asarray(joints, dtype=np.float64) / STRIDE - 0.5
    proximal, distal = (list(joint) for joint in zip(*(LIMBS[k].ends for k in limbs), strict=True))
    begin, end = cells[:, proximal], cells[:, distal]
    has_begin, has_end = annotated[:, proximal], annotated[:, distal]
    from_begin = x - begin[..., :1], y - begin[..., 1:]
    high = _gaussians(*from_begin, has_begin)
    low = _gaussians(x - end[..., :1], y - end[..., 1:], has_end)
    # The largest absolute value is kept, with its sign.
    fields[:, HEAT] = np.where(high >= low, high, -low)
    fields[:, :HEAT] = _affinities(*from_begin, end - begin, has_begin & has_end)
    return fields


def _gaussians(
    x: NDArray[np.float64], y: NDArray[np.float64], present: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return the largest Gaussian (limbs, rows, columns) in every cell (eq. 4.4).

    :param x: (people, limbs, columns) from a joint to the columns, cells.
    :param y: (people, limbs, rows) from a joint to the rows, cells.
    :param present: (people, limbs) whether the joint is known.
    """
    # A Gaussian is the product of a Gaussian along x and a Gaussian along y.
    along_x, along_y = np.exp(-((x / SIGMA) ** 2)), np.exp(-((y / SIGMA) ** 2))
    peaks = along_y[..., :, None] * along_x[..., None, :] * present[..., None, None]
    largest: NDArray[np.float64] = peaks.max(axis=0)
    largest[largest < _FAINTEST] = 0.0
    return largest


def _affinities(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    along: NDArray[np.float64],
    present: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """Return the mean direction (limbs, 2, rows, columns) of the limbs in a cell (eq. 4.5, 4.6).

    :param x: (people, limbs, columns) from the proximal joint to the columns, cells.
    :param y: (people, limbs, rows) from the proximal joint to the rows, cells.
    :param along: (people, limbs, 2) from the proximal to the distal joint, cells.
    :param present: (people, limbs) whether both joints are known.
    """
    length = np.linalg.norm(along, axis=-1)
    direction = along / np.maximum(length, 1e-9)[..., None]
    unit_x, unit_y = direction[..., 0, None, None], direction[..., 1, None, None]
    forward = unit_x * x[..., None, :] + unit_y * y[..., :, None]
    sideways = unit_x * y[..., :, None] - unit_y * x[..., None, :]
    covered = (forward >= 0) & (forward <= length[..., None, None])
    covered &= (np.abs(sideways) <= HALF_WIDTH) & present[..., None, None]
    count = np.maximum(covered.sum(axis=0), 1)
    total = np.einsum("plc,plrw->lcrw", direction, covered.astype(np.float64))
    return total / count[:, None]


def loss_mask(
    annotated: NDArray[np.bool_],
    boxes: NDArray[np.floating],
    size: tuple[int, int],
    limbs: Sequence[int],
) -> NDArray[np.float32]:
    """Return where the loss counts (W of equation 4.1).

    The loss of a limb does not count inside the box of a person with an unknown joint of that limb:
    the joint may be in the picture, and detecting it is correct.

    :param annotated: (people, 14) whether a joint's position is known.
    :param boxes: (people, 4) left, top, right, bottom in pixels.
    :param size: height and width of the picture in pixels.
    :param limbs: indices into :data:`~.skeleton.LIMBS`.
    :return: (limbs, rows, columns): 1 where the loss counts, else 0.
    """
    y, x = ((np.arange(side // STRIDE) + 0.5) * STRIDE for side in size)
    mask = np.ones((len(limbs), len(y), len(x)), dtype=np.float32)
    for known, (left, top, right, bottom) in zip(annotated, boxes, strict=True):
        unknown = [not known[list(LIMBS[limb].ends)].all() for limb in limbs]
        inside = ((y >= top) & (y <= bottom))[:, None] & ((x >= left) & (x <= right))
        mask[np.array(unknown, dtype=bool)[:, None, None] & inside] = 0.0
    return mask
