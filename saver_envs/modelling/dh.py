"""The Denavit-Hartenberg tables of the paper as chains.

The tables count joints from another zero than the makers do, and the MICO's first joint the other
way round. Angles here are the makers' throughout, as in the simulator and on the arm: each row has
the offset, and the direction, that leads from them to the table's variable.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from saver_envs.modelling.chain import Chain, FloatArray

_HALF_PI = math.pi / 2


@dataclass(frozen=True)
class Row:
    """A joint of a table: the variable of the table is ``direction * joint + offset``.

    :param a: length, metres; a_(i-1) in a modified table.
    :param alpha: twist, radians; alpha_(i-1) in a modified table.
    :param d: offset along the axis, metres, without the joint's own part.
    :param offset: radians, or metres of a slide.
    :param direction: 1 or -1.
    :param prismatic: whether the joint slides.
    """

    a: float
    alpha: float
    d: float
    offset: float = 0.0
    direction: int = 1
    prismatic: bool = False


# MICO: the maker's lengths (kinova-ros, m1n4s200), metres. Row 3 has the lateral offset of 7 mm
# that the table leaves out.
_SHOULDER_HEIGHT, _UPPER_ARM, _LATERAL = 0.15675 + 0.11875, 0.29, 0.0016 - 0.0086
_FOREARM = 0.1231

#: Table 7.1, modified (Craig). The end effector lies on the axis of joint 4: `mico_chain` adds it.
MICO_TABLE = (
    Row(0.0, 0.0, _SHOULDER_HEIGHT, direction=-1),
    Row(0.0, -_HALF_PI, 0.0, offset=_HALF_PI, direction=-1),
    Row(_UPPER_ARM, 0.0, _LATERAL, offset=-3 * _HALF_PI),
    Row(0.0, -_HALF_PI, _FOREARM, direction=-1),
)
#: Distance of the maker's end effector from joint 4 (m), and that of the tool between the
#: fingertips to which the environments' set-points refer.
MICO_END_EFFECTOR, MICO_TOOL = 0.16, 0.188
#: Joint limits of Table 7.1 (rad), those of its own angles.
MICO_TABLE_LIMITS = (
    (-math.pi, math.pi),
    (-11 / 18 * math.pi, 1 / 9 * math.pi),
    (-23 / 36 * math.pi, 5 / 36 * math.pi),
    (-math.pi, math.pi),
)

#: Table 7.2, standard, with the lengths of the MJCF in the gymnasium-robotics wheel (m). The last
#: row ends at the frame of the gripper, 0.1664 m behind the last joint.
FETCH_TABLE = (
    Row(-0.0869 + 0.1195, 0.0, 0.3774 + 0.3486, prismatic=True),
    Row(0.117, -_HALF_PI, 0.06),
    Row(0.0, -_HALF_PI, 0.0, offset=-_HALF_PI),
    Row(0.0, _HALF_PI, 0.219 + 0.133),
    Row(0.0, -_HALF_PI, 0.0),
    Row(0.0, _HALF_PI, 0.197 + 0.1245),
    Row(0.0, -_HALF_PI, 0.0),
    Row(0.0, 0.0, 0.1385 + 0.1664),
)


def chain_of_table(rows: Sequence[Row], convention: Literal["modified", "standard"]) -> Chain:
    """Return the chain of a table; its tool is the frame of the last row.

    :param rows: joints from the base on.
    :param convention: ``modified`` (Craig: length and twist come before the joint) or
        ``standard`` (they come behind it).
    :raises ValueError: for another convention.
    """
    if convention not in ("modified", "standard"):
        raise ValueError(f"convention={convention!r}: must be 'modified' or 'standard'")
    before, after = [], []
    for row in rows:
        fixed = _translation(row.a, 0, 0) @ _turn_about_x(row.alpha)
        along = _translation(0, 0, row.d + (row.offset if row.prismatic else 0.0))
        zero = along if row.prismatic else _turn_about_z(row.offset) @ along
        modified = convention == "modified"
        before.append(fixed @ zero if modified else zero)
        after.append(np.eye(4) if modified else fixed)
    return Chain(
        np.array(before),
        np.array(after),
        np.array([row.direction for row in rows], dtype=np.float64),
        np.array([row.prismatic for row in rows]),
        np.eye(4),
    )


def table_limits(
    rows: Sequence[Row], limits: Sequence[tuple[float, float]]
) -> tuple[FloatArray, FloatArray]:
    """Turn limits of a table's variables into limits of the makers' joints.

    :return: lower and upper limits (dof,), radians or metres.
    """
    ends = np.array(
        [
            sorted((end - row.offset) / row.direction for end in pair)
            for row, pair in zip(rows, limits, strict=True)
        ]
    )
    return ends[:, 0], ends[:, 1]


def mico_chain(tool_distance: float = MICO_END_EFFECTOR) -> Chain:
    """Return the MICO of Table 7.1.

    :param tool_distance: of the tool from joint 4, on its axis, metres.
    """
    return chain_of_table(MICO_TABLE, "modified").with_tool(_translation(0, 0, tool_distance))


def fetch_chain() -> Chain:
    """Return the Fetch of Table 7.2; its base is that of the mobile base."""
    return chain_of_table(FETCH_TABLE, "standard")


def _translation(x: float, y: float, z: float) -> FloatArray:
    transform = np.eye(4)
    transform[:3, 3] = x, y, z
    return transform


def _turn_about_x(angle: float) -> FloatArray:
    transform, sine, cosine = np.eye(4), math.sin(angle), math.cos(angle)
    transform[1:3, 1:3] = ((cosine, -sine), (sine, cosine))
    return transform


def _turn_about_z(angle: float) -> FloatArray:
    transform, sine, cosine = np.eye(4), math.sin(angle), math.cos(angle)
    transform[:2, :2] = ((cosine, -sine), (sine, cosine))
    return transform
