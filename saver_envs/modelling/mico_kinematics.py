"""Inverse kinematics of the MICO in closed form: every branch at once.

Joint 1 turns the plane of the arm to the target, 7 mm beside the axis, forwards or over the back;
in that plane upper arm and forearm are two sides of a triangle, elbow on either side. Joint 4 does
not move the tool: it is the caller's to choose.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from saver_envs.modelling.chain import FloatArray
from saver_envs.modelling.dh import MICO_END_EFFECTOR, MICO_TABLE
from saver_envs.robots.mico import JOINT_LOWER, JOINT_UPPER

_HEIGHT, _UPPER_ARM, _LATERAL = MICO_TABLE[0].d, MICO_TABLE[2].a, MICO_TABLE[2].d
_FOREARM = MICO_TABLE[3].d
_TURN = 2 * math.pi
#: Cosines so far beyond 1 are rounding at the edge of the workspace.
_ROUNDING = 1e-12


def inverse_kinematics(
    targets: FloatArray, tool_distance: float = MICO_END_EFFECTOR
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the joint angles that put the tool at points.

    :param targets: (n, 3) in the base frame, metres.
    :param tool_distance: of the tool from joint 4, metres.
    :return: angles (n, 4, 3) of joints 1 to 3 in radians, joint 1 in [-pi, pi), and which of the
        four branches exist within the joint limits (n, 4). Branches that do not are zero.
    """
    targets = np.asarray(targets, dtype=np.float64)
    forearm = _FOREARM + tool_distance
    in_plane = targets[:, 0] ** 2 + targets[:, 1] ** 2 - _LATERAL**2
    height = targets[:, 2] - _HEIGHT
    cosine = (in_plane + height**2 - _UPPER_ARM**2 - forearm**2) / (2 * _UPPER_ARM * forearm)
    exists: NDArray[np.bool_] = (in_plane >= 0) & (np.abs(cosine) <= 1 + _ROUNDING)
    bend = np.arccos(np.clip(cosine, -1, 1))
    reach = np.sqrt(np.maximum(in_plane, 0))
    joints, valid = np.zeros((len(targets), 4, 3)), np.zeros((len(targets), 4), dtype=bool)
    for branch in range(4):
        x = reach if branch < 2 else -reach
        elbow = bend if branch % 2 == 0 else -bend
        turn = np.arctan2(_LATERAL, x) - np.arctan2(targets[:, 1], targets[:, 0])
        lean = np.arctan2(x, height)
        lean -= np.arctan2(forearm * np.sin(elbow), _UPPER_ARM + forearm * np.cos(elbow))
        angles = np.stack(
            [
                (turn + math.pi) % _TURN - math.pi,
                (math.pi - lean) % _TURN,
                (elbow + math.pi) % _TURN,
            ],
            axis=-1,
        )
        inside: NDArray[np.bool_] = (angles >= JOINT_LOWER[:3]) & (angles <= JOINT_UPPER[:3])
        valid[:, branch] = exists & inside.all(axis=-1)
        joints[:, branch] = np.where(valid[:, branch, None], angles, 0.0)
    return joints, valid


def nearest_branch(
    targets: FloatArray, present: FloatArray, tool_distance: float = MICO_END_EFFECTOR
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return of all branches the one that is nearest to the present joints.

    :param targets: (n, 3), metres.
    :param present: (n, 4) joint angles, radians; joint 4 is kept, joint 1 turns the shorter way.
    :param tool_distance: of the tool from joint 4, metres.
    :return: joint angles (n, 4), the present ones where no branch exists, and where one does (n,).
    """
    joints, valid = inverse_kinematics(targets, tool_distance)
    change = joints - present[:, None, :3]
    change[..., 0] = (change[..., 0] + math.pi) % _TURN - math.pi
    distance = np.where(valid, np.square(change).sum(axis=-1), np.inf)
    rows, best = np.arange(len(targets)), distance.argmin(axis=1)
    reached: NDArray[np.bool_] = np.logical_or.reduce(valid, axis=1)
    found = np.array(present, dtype=np.float64)
    found[:, :3] += np.where(reached[:, None], change[rows, best], 0.0)
    return found, reached
