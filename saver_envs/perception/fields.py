"""What the network learns to draw: bipolar heat maps and part affinity fields (eq. 4.4 to 4.6).

Points are continuous picture coordinates in pixels: (0, 0) is the corner at the top left, the
middle of the first pixel lies at (0.5, 0.5). So a point in a picture of half the size has half the
coordinates, and cell (row, column) of a field of stride 8 is centred at
(8 (column + 1/2), 8 (row + 1/2)).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from saver_envs.perception.skeleton import LIMBS

#: Pixels of the picture per cell of a field, along both axes (SPEC 5.2).
STRIDE: Final = 8
#: Channels of a limb: affinity along x, affinity along y, heat.
AFFINITY_X, AFFINITY_Y, HEAT, N_CHANNELS = 0, 1, 2, 3
#: Gaussians weaker than this are not drawn.
_FAINTEST: Final = 1e-4


@dataclass(frozen=True)
class FieldShape:
    """How wide joints and limbs are drawn, in cells of the field. Ours: the paper gives no numbers.

    :param sigma: of exp(-d^2 / sigma^2), equation 4.4. At 1.2 a peak covers the 3 x 3 cells that
        its position between cells is read from, and two joints 3 cells apart stay apart.
    :param half_width: of a limb's band, equation 4.5.
    """

    sigma: float = 1.2
    half_width: float = 1.0


def encode(
    joints: NDArray[np.floating],
    annotated: NDArray[np.bool_],
    size: tuple[int, int],
    limbs: Sequence[int],
    shape: FieldShape = FieldShape(),
    stride: int = STRIDE,
) -> NDArray[np.float32]:
    """Draw the fields of all people in a picture.

    Where bands of several people overlap, their directions are averaged over those people
    (equation 4.6 with the count taken cell by cell: counting all the people in the picture would
    make a limb fainter because there is another one elsewhere).

    :param joints: (people, 14, 2) pixels of the picture; joints may lie outside of it.
    :param annotated: (people, 14) whether the position is known. A limb is drawn where both its
        joints are, a peak where its joint is.
    :param size: height and width of the picture in pixels, multiples of ``stride``.
    :param limbs: which of the 13 limbs, indices into :data:`~.skeleton.LIMBS`.
    :param shape: of peaks and bands.
    :param stride: pixels per cell.
    :return: (limbs, 3, height / stride, width / stride): affinity x, affinity y, heat. The heat is
        +1 at proximal and -1 at distal joints.
    :raises ValueError: for a size that is no multiple of ``stride``.
    """
    height, width = size
    if height % stride or width % stride:
        raise ValueError(f"size={size}: height and width must be multiples of {stride}")
    rows, columns = height // stride, width // stride
    cells = np.asarray(joints, dtype=np.float64) / stride - 0.5
    proximal = [LIMBS[limb].proximal for limb in limbs]
    distal = [LIMBS[limb].distal for limb in limbs]
    fields = np.zeros((len(limbs), N_CHANNELS, rows, columns), dtype=np.float32)
    if len(cells) == 0:
        return fields
    begin, end = cells[:, proximal], cells[:, distal]
    has_begin, has_end = annotated[:, proximal], annotated[:, distal]
    high = _peaks(begin, has_begin, rows, columns, shape.sigma)
    low = _peaks(end, has_end, rows, columns, shape.sigma)
    # The largest absolute value wins, and keeps its sign.
    fields[:, HEAT] = np.where(high >= low, high, -low)
    fields[:, :HEAT] = _affinities(begin, end, has_begin & has_end, rows, columns, shape.half_width)
    return fields


def _peaks(
    points: NDArray[np.float64],
    present: NDArray[np.bool_],
    rows: int,
    columns: int,
    sigma: float,
) -> NDArray[np.float64]:
    """Strongest Gaussian in every cell (eq. 4.4) of points (people, limbs, 2) in cells."""
    # A Gaussian is the product of one along x and one along y.
    along_x = np.exp(-(((np.arange(columns) - points[..., :1]) / sigma) ** 2))
    along_y = np.exp(-(((np.arange(rows) - points[..., 1:]) / sigma) ** 2))
    peaks = along_y[..., :, None] * along_x[..., None, :] * present[..., None, None]
    strongest: NDArray[np.float64] = peaks.max(axis=0)
    strongest[strongest < _FAINTEST] = 0.0
    return strongest


def _affinities(
    begin: NDArray[np.float64],
    end: NDArray[np.float64],
    present: NDArray[np.bool_],
    rows: int,
    columns: int,
    half_width: float,
) -> NDArray[np.float64]:
    """Mean direction (limbs, 2, rows, columns) of the limbs that cover a cell (eq. 4.5, 4.6)."""
    along = end - begin
    length = np.linalg.norm(along, axis=-1)
    direction = along / np.maximum(length, 1e-9)[..., None]
    x = np.arange(columns) - begin[..., :1]  # (people, limbs, columns)
    y = np.arange(rows) - begin[..., 1:]
    unit_x, unit_y = direction[..., 0, None, None], direction[..., 1, None, None]
    forward = unit_x * x[..., None, :] + unit_y * y[..., :, None]
    sideways = unit_x * y[..., :, None] - unit_y * x[..., None, :]
    covered = (
        (forward >= 0)
        & (forward <= length[..., None, None])
        & (np.abs(sideways) <= half_width)
        & present[..., None, None]
    )
    count = np.maximum(covered.sum(axis=0), 1)
    total = np.einsum("plc,plrw->lcrw", direction, covered.astype(np.float64))
    mean: NDArray[np.float64] = total / count[:, None]
    return mean


def loss_mask(
    annotated: NDArray[np.bool_],
    boxes: NDArray[np.floating],
    size: tuple[int, int],
    limbs: Sequence[int],
    stride: int = STRIDE,
) -> NDArray[np.float32]:
    """Say where the loss counts (W of equation 4.1).

    It does not count inside the box of a person of whom one of a limb's joints is not annotated:
    the joint may be in the picture, and finding it must cost nothing.

    :param annotated: (people, 14) whether a joint's position is known.
    :param boxes: (people, 4) left, top, right, bottom in pixels.
    :param size: height and width of the picture in pixels.
    :param limbs: indices into :data:`~.skeleton.LIMBS`.
    :param stride: pixels per cell.
    :return: (limbs, rows, columns): 1 where it counts, else 0.
    """
    rows, columns = size[0] // stride, size[1] // stride
    mask = np.ones((len(limbs), rows, columns), dtype=np.float32)
    x, y = (np.arange(columns) + 0.5) * stride, (np.arange(rows) + 0.5) * stride
    for known, (left, top, right, bottom) in zip(annotated, boxes, strict=True):
        unknown = [
            not (known[LIMBS[limb].proximal] and known[LIMBS[limb].distal]) for limb in limbs
        ]
        inside = ((y >= top) & (y <= bottom))[:, None] & ((x >= left) & (x <= right))
        mask[np.array(unknown, dtype=bool)[:, None, None] & inside] = 0.0
    return mask
