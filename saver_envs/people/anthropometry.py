"""Masses, lengths and inertia of the body's segments, of women and men.

Source: table 4 of de Leva 1996 with its alternative end points, see
:mod:`saver_envs.people.limp_sources`. The shares of mass are those of athletic young adults; they
are kept for other builds, which puts too little of a heavy person's mass into the trunk.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

Sex = Literal["female", "male"]
SEXES: Final[tuple[Sex, ...]] = ("female", "male")


@dataclass(frozen=True)
class SegmentTable:
    """A segment of the published table.

    :param mass: share of the body's mass.
    :param length: share of the stature.
    :param centre: of mass, from the proximal end (of trunk and head: the upper one), share of the
        length.
    :param sagittal: radius of gyration about the axis from back to front, share of the length.
    :param transverse: radius of gyration about the axis from side to side, share of the length.
    :param longitudinal: radius of gyration about the long axis, share of the length.
    """

    mass: float
    length: float
    centre: float
    sagittal: float
    transverse: float
    longitudinal: float


def _rows(stature: float, rows: dict[str, tuple[float, ...]]) -> dict[str, SegmentTable]:
    """Read rows of percent of body mass, millimetres, and four times percent of the length."""
    return {
        name: SegmentTable(mass / 100, length / stature, *(part / 100 for part in parts))
        for name, (mass, length, *parts) in rows.items()
    }


#: Segments by sex. Head from the vertex to C7, upper trunk from C7 to the xiphoid, middle trunk to
#: the navel, lower trunk to the middle of the hip joints; hand to the tip of the third finger, foot
#: from the heel to the tip of the second toe.
DE_LEVA: Final[dict[Sex, dict[str, SegmentTable]]] = {
    "female": _rows(
        1735.0,
        {
            "head": (6.68, 243.7, 48.41, 27.1, 29.5, 26.1),
            "upper_trunk": (15.45, 228.0, 50.50, 46.6, 31.4, 44.9),
            "middle_trunk": (14.65, 205.3, 45.12, 43.3, 35.4, 41.5),
            "lower_trunk": (12.47, 181.5, 49.20, 43.3, 40.2, 44.4),
            "upper_arm": (2.55, 275.1, 57.54, 27.8, 26.0, 14.8),
            "forearm": (1.38, 264.3, 45.59, 26.1, 25.7, 9.4),
            "hand": (0.56, 170.1, 34.27, 24.4, 20.8, 15.4),
            "thigh": (14.78, 368.5, 36.12, 36.9, 36.4, 16.2),
            "shank": (4.81, 438.6, 43.52, 26.7, 26.3, 9.2),
            "foot": (1.29, 228.3, 40.14, 29.9, 27.9, 13.9),
        },
    ),
    "male": _rows(
        1741.0,
        {
            "head": (6.94, 242.9, 50.02, 30.3, 31.5, 26.1),
            "upper_trunk": (15.96, 242.1, 50.66, 50.5, 32.0, 46.5),
            "middle_trunk": (16.33, 215.5, 45.02, 48.2, 38.3, 46.8),
            "lower_trunk": (11.17, 145.7, 61.15, 61.5, 55.1, 58.7),
            "upper_arm": (2.71, 281.7, 57.72, 28.5, 26.9, 15.8),
            "forearm": (1.62, 268.9, 45.74, 27.6, 26.5, 12.1),
            "hand": (0.61, 187.9, 36.24, 28.8, 23.5, 18.4),
            "thigh": (14.16, 422.2, 40.95, 32.9, 32.9, 14.9),
            "shank": (4.33, 440.3, 43.95, 25.1, 24.6, 10.2),
            "foot": (1.37, 258.1, 44.15, 25.7, 24.5, 12.4),
        },
    ),
}
#: Segments of the trunk, from the neck downwards.
TRUNK: Final = ("upper_trunk", "middle_trunk", "lower_trunk")


@dataclass(frozen=True)
class Inertia:
    """Mass, centre of mass and inertia of a rigid body, about that centre.

    :param mass: kg.
    :param centre: (3,) metres.
    :param tensor: (3, 3) kg m^2.
    """

    mass: float
    centre: NDArray[np.float64]
    tensor: NDArray[np.float64]


def segment_inertia(
    table: SegmentTable,
    mass: float,
    begin: NDArray[np.float64],
    end: NDArray[np.float64],
    front: NDArray[np.float64],
) -> Inertia:
    """Return the inertia of a segment between two points.

    :param table: of the segment.
    :param mass: of the whole body, kg.
    :param begin: (3,) proximal or upper end, metres.
    :param end: (3,) the other one, metres.
    :param front: (3,) any vector towards the front of the segment that is not along it.
    """
    way = end - begin
    length = float(np.linalg.norm(way))
    along = way / length
    side = np.cross(along, front)
    side /= np.linalg.norm(side)
    axes = np.stack([along, side, np.cross(side, along)], axis=1)
    radii = length * np.array([table.longitudinal, table.transverse, table.sagittal])
    own = mass * table.mass
    tensor = axes @ np.diag(own * radii**2) @ axes.T
    return Inertia(own, begin + table.centre * way, tensor)


def joined_inertia(parts: list[Inertia]) -> Inertia:
    """Return the inertia of several bodies that are one (parallel axes)."""
    mass = sum(part.mass for part in parts)
    centre = np.sum([part.mass * part.centre for part in parts], axis=0) / mass
    tensor = np.zeros((3, 3))
    for part in parts:
        lever = part.centre - centre
        tensor += part.tensor
        tensor += part.mass * (lever @ lever * np.eye(3) - np.outer(lever, lever))
    return Inertia(mass, centre, tensor)
