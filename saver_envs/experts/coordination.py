"""Two or more arms give way to one another: who goes first, and where the others keep meanwhile.

The rule is one of order along y, the line on which the bases stand. The arm that goes first takes
its way; every other hand keeps to its own side of that way. It needs no memory: the leader is
chosen anew at each step, by what the positions of cubes and targets allow, then by who has less
left to do, and going ahead makes its lead grow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating]

#: A hand keeps this far, in y, from the way of the arm that goes first (m): a palm's width and air.
SIDE_CLEARANCE = 0.145
#: A hand stops for another that is this near and in front of it (m).
HAND_CLEARANCE = 0.135
#: Cubes closer to a way than this block it (m).
CUBE_CLEARANCE = 0.075
#: A hand that is not pushing goes round cubes at this distance from their centres (m).
DETOUR = 0.082


@dataclass(frozen=True)
class Way:
    """What is left of each arm's task, in the world frame; leading dimensions (n, arms).

    :param points: (n, arms, points, 2) corners of the hand's way, its present place first, metres.
    :param cube: (n, arms, 2), metres.
    :param target: (n, arms, 2), metres.
    :param left: (n, arms) length of the way, metres; 0 where the arm is done.
    """

    points: FloatArray
    cube: FloatArray
    target: FloatArray
    left: FloatArray


def leads(way: Way, first: int, second: int) -> NDArray[np.bool_]:
    """Say where ``first`` goes before ``second``, (n,).

    An arm that is done yields; else the one that alone can finish without blocking the other
    leads; else the one with less left to do.
    """
    first_can, second_can = _can_go_first(way, first, second), _can_go_first(way, second, first)
    nearer = way.left[:, first] <= way.left[:, second]
    leader = np.where(first_can == second_can, nearer, first_can)
    leader = np.where(way.left[:, second] == 0, True, leader)
    result: NDArray[np.bool_] = np.where(way.left[:, first] == 0, False, leader)
    return result


def _can_go_first(way: Way, one: int, other: int) -> NDArray[np.bool_]:
    own = distance_to_segment(way.cube[:, other], way.cube[:, one], way.target[:, one])
    others = distance_to_segment(way.target[:, one], way.cube[:, other], way.target[:, other])
    clear: NDArray[np.bool_] = (own >= CUBE_CLEARANCE) & (others >= CUBE_CLEARANCE)
    return clear


def give_way(way: Way, goal: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Move goals of arms that must yield to their own side of the leader's way.

    :param way: what each arm still has to do.
    :param goal: (n, arms, 2) where each hand wants to go next, world frame, metres; arms are
        ordered by their bases' y.
    :return: the goals, and which hands were turned aside (n, arms).
    """
    goal = goal.copy()
    turned = np.zeros(goal.shape[:2], dtype=bool)
    lowest, highest = way.points[..., 1].min(axis=-1), way.points[..., 1].max(axis=-1)
    for first in range(goal.shape[1] - 1):
        second = first + 1
        first_leads = leads(way, first, second)
        limit_second = highest[:, first] + SIDE_CLEARANCE
        limit_first = lowest[:, second] - SIDE_CLEARANCE
        # An arm with nothing left to do does not hold its neighbour up.
        second_yields = first_leads & (way.left[:, first] > 0)
        second_yields &= (goal[:, second, 1] < limit_second) | (
            way.points[:, second, 0, 1] < limit_second
        )
        first_yields = ~first_leads & (way.left[:, second] > 0)
        first_yields &= (goal[:, first, 1] > limit_first) | (
            way.points[:, first, 0, 1] > limit_first
        )
        goal[:, second, 1] = np.where(
            second_yields, np.maximum(goal[:, second, 1], limit_second), goal[:, second, 1]
        )
        goal[:, first, 1] = np.where(
            first_yields, np.minimum(goal[:, first, 1], limit_first), goal[:, first, 1]
        )
        turned[:, second] |= second_yields
        turned[:, first] |= first_yields
    return goal, turned


def stop_before_hands(tool: FloatArray, move: FloatArray, yields: NDArray[np.bool_]) -> FloatArray:
    """Take from moves the part that leads towards a hand that is too near.

    :param tool: (n, arms, 2) hands, world frame, metres.
    :param move: (n, arms, 2) displacements, metres.
    :param yields: (n, arms) hands that are getting out of the way, which are not held.
    :return: the moves.
    """
    move = move.copy()
    arms = tool.shape[1]
    for arm in range(arms):
        for other in range(arms):
            if arm == other:
                continue
            gap = tool[:, other] - tool[:, arm]
            distance = np.linalg.norm(gap, axis=-1)
            towards = np.sum(move[:, arm] * gap, axis=-1) / np.maximum(distance, 1e-6)
            held = (distance < HAND_CLEARANCE) & (towards > 0)
            excess = np.where(held, towards / np.maximum(distance, 1e-6), 0.0)
            move[:, arm] -= excess[:, None] * gap
    return move


def go_round(
    tool: FloatArray, move: FloatArray, cube: FloatArray, applies: NDArray[np.bool_]
) -> FloatArray:
    """Turn moves that would run into a cube to pass beside it.

    :param tool: (n, arms, 2) hands, metres.
    :param move: (n, arms, 2) displacements, metres.
    :param cube: (n, arms, 2) the cube that each hand shall not touch, metres.
    :param applies: (n, arms) where the rule holds.
    :return: the moves.
    """
    gap = cube - tool
    distance = np.linalg.norm(gap, axis=-1, keepdims=True)
    ahead = gap / np.maximum(distance, 1e-6)
    towards = np.sum(move * ahead, axis=-1, keepdims=True)
    length = np.linalg.norm(move, axis=-1, keepdims=True)
    side = np.stack([-ahead[..., 1], ahead[..., 0]], axis=-1)
    sign = np.where(np.sum(move * side, axis=-1, keepdims=True) >= 0, 1.0, -1.0)
    beside = sign * side * length
    near = applies[..., None] & (distance < DETOUR) & (towards > 0.1 * length)
    return np.where(near, beside, move)


def distance_to_segment(point: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """Distance (n,) of points (n, 2) to segments, metres."""
    way = end - start
    share = np.sum((point - start) * way, axis=-1) / np.maximum(np.sum(way * way, axis=-1), 1e-9)
    nearest = start + np.clip(share, 0.0, 1.0)[..., None] * way
    return np.linalg.norm(point - nearest, axis=-1)
