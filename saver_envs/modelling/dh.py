"""Denavit-Hartenberg tables as chains.

Joint angles are the makers' throughout, as in the simulator and on the arm. A table may count a
joint from another zero or in the other direction: its row has the offset and the direction that
convert the maker's angle to the table's variable.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from saver_envs.modelling.chain import Chain, FloatArray


@dataclass(frozen=True)
class DHRow:
    """A joint of a table: the table's variable is ``direction * joint + offset``.

    :param a: length, metres; a_(i-1) in a modified table.
    :param alpha: twist, radians; alpha_(i-1) in a modified table.
    :param d: constant offset along the axis, metres.
    :param offset: radians, or metres for a slide.
    :param direction: 1 or -1.
    :param prismatic: whether the joint slides.
    """

    a: float
    alpha: float
    d: float
    offset: float = 0.0
    direction: int = 1
    prismatic: bool = False


def chain_of_table(rows: Sequence[DHRow], convention: Literal["modified", "standard"]) -> Chain:
    """Return the chain of a table; its tool is the frame of the last row.

    :param rows: joints from the base on.
    :param convention: ``modified`` (Craig: length and twist precede the joint) or ``standard``
        (they follow it).
    :raises ValueError: for another convention.
    """
    if convention not in ("modified", "standard"):
        raise ValueError(f"convention={convention!r}: must be 'modified' or 'standard'")
    modified = convention == "modified"
    before, after = [], []
    for row in rows:
        fixed = translation(row.a, 0, 0) @ _rotation(row.alpha, 1, 2)
        zero = translation(0, 0, row.d + (row.offset if row.prismatic else 0.0))
        if not row.prismatic:
            zero = _rotation(row.offset, 0, 1) @ zero
        before.append(fixed @ zero if modified else zero)
        after.append(np.eye(4) if modified else fixed)
    return Chain(
        np.array(before),
        np.array(after),
        np.array([row.direction for row in rows], dtype=np.float64),
        np.array([row.prismatic for row in rows]),
        np.eye(4),
    )


def translation(x: float, y: float, z: float) -> FloatArray:
    """Return a translation (4, 4), metres."""
    transform = np.eye(4)
    transform[:3, 3] = x, y, z
    return transform


def _rotation(angle: float, first: int, second: int) -> FloatArray:
    """Return a rotation (4, 4) by ``angle`` from one axis towards another."""
    transform, sine, cosine = np.eye(4), math.sin(angle), math.cos(angle)
    transform[first, first], transform[first, second] = cosine, -sine
    transform[second, first], transform[second, second] = sine, cosine
    return transform
