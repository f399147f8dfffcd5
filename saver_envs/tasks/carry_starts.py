"""Draws a board on the table, a target in the air, and hands above the grips."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from saver_envs.control import length
from saver_envs.reachability import ReachabilityMap
from saver_envs.scenes import Scene
from saver_envs.simulation import rotate_by_quaternion
from saver_envs.tasks.board import BOARD_HALF, ENDS, GRIP_HALF, HELD_HEIGHT
from saver_envs.tasks.contract import NoStart, Start
from saver_envs.tasks.regions import Regions
from saver_envs.tasks.sampling import HAND_TO_OBJECT, FloatArray, points_around

#: Where the middle of the board may be, at the start and at its target: x and y (m); and its turn
#: about the vertical (rad).
DEPTH, SIDEWAYS, YAW = (0.34, 0.52), (-0.10, 0.10), (-0.30, 0.30)
#: How high above the table the board is at its target (m): so high that one hand cannot tilt it
#: there.
RISE = (0.08, 0.25)
#: Distance of an end from its target (m).
END_TO_TARGET = (0.10, 0.30)
#: The block lies on the board within this of its middle, across and along it (m).
LOAD_SPREAD: Final = (0.03, 0.10)
#: Lowest and highest start of a hand above the top of the grips (m): fingers are open.
ABOVE_GRIPS = (0.03, 0.13)
_BLOCK, _MOST_BLOCKS = 64, 100


@dataclass(frozen=True)
class CarryStart(Start):
    """A start of one episode.

    :param board: (7,) position and quaternion of the board, world frame, metres.
    :param load: (2,) middle of the block on the board, in its frame, metres.
    :param target: (arms, 3) where the ends are to be, in the base frames, metres.
    """

    board: FloatArray
    load: FloatArray
    target: FloatArray


class CarryStartSampler:
    """Draws starts for one scene.

    Both ends, at the start, at the target and half-way, are where their arms can hold them.

    :param scene: says where the bases stand.
    :param regions: the boxes of ends and the workspace of hands.
    :param reachability: the robot's map.
    :param table_height: height of the table above the bases, metres.
    """

    def __init__(
        self, scene: Scene, regions: Regions, reachability: ReachabilityMap, table_height: float
    ) -> None:
        self._scene, self._regions, self._reachability = scene, regions, reachability
        self._table = table_height

    def sample(self, generator: np.random.Generator) -> CarryStart:
        """Draw a start.

        :param generator: the episode's source of randomness.
        :return: the start.
        :raises NoStart: when none is found, for a table that is too high for these arms.
        """
        for _ in range(_MOST_BLOCKS):
            board, target = self._draw_board(generator, 0.0), self._draw_board(generator, 1.0)
            ends, goals = self._ends(board), self._ends(target)
            for one in np.flatnonzero(self._ways_valid(ends, goals)):
                hand = self._draw_hands(generator, ends[one])
                valid = np.flatnonzero(self._hands_valid(hand))
                if valid.size:
                    load = generator.uniform(-1.0, 1.0, 2) * LOAD_SPREAD
                    return CarryStart(hand[valid[0]], board[one], load, goals[one])
        raise NoStart(
            f"no board that both arms can hold in {_MOST_BLOCKS * _BLOCK} candidates: "
            f"table_height={self._table} m leaves no room"
        )

    def _draw_board(self, generator: np.random.Generator, lifted: float) -> FloatArray:
        """Draw poses (block, 7) of boards on the table, or ``lifted`` (1) above it."""
        pose = np.zeros((_BLOCK, 7))
        pose[:, 0] = generator.uniform(*DEPTH, _BLOCK)
        pose[:, 1] = generator.uniform(*SIDEWAYS, _BLOCK)
        rise = generator.uniform(*RISE, _BLOCK)
        pose[:, 2] = self._table + BOARD_HALF[2] + lifted * rise
        yaw = generator.uniform(*YAW, _BLOCK) / 2
        pose[:, 3], pose[:, 6] = np.cos(yaw), np.sin(yaw)
        return pose

    def _ends(self, board: FloatArray) -> FloatArray:
        """Return the ends (block, arms, 3) of boards, in the base frames, metres."""
        world = board[:, None, :3] + rotate_by_quaternion(board[:, None, 3:], ENDS)
        return self._scene.to_bases(world)

    def _ways_valid(self, ends: FloatArray, goals: FloatArray) -> NDArray[np.bool_]:
        """Return which ends and goals (block, arms, 3) can be held, and how far apart they are."""
        valid = np.ones(len(ends), dtype=bool)
        for points in (ends, (ends + goals) / 2, goals):
            level = points[..., :2]
            lower, upper = self._regions.object_lower, self._regions.object_upper
            held = np.logical_and.reduce((level >= lower) & (level <= upper), axis=-1)
            held &= (length(level) <= self._regions.reach) & self._reachability.reachable(points)
            valid &= np.logical_and.reduce(held, axis=-1)
        way = length(goals - ends)
        far = (way >= END_TO_TARGET[0]) & (way <= END_TO_TARGET[1])
        return valid & np.logical_and.reduce(far, axis=-1)

    def _draw_hands(self, generator: np.random.Generator, ends: FloatArray) -> FloatArray:
        """Draw a block of hands (block, arms, 3) above the ends (arms, 3)."""
        centres = np.broadcast_to(ends, (_BLOCK, *ends.shape))
        height = generator.uniform(*ABOVE_GRIPS, centres.shape[:-1])
        height += ends[:, 2] + 2 * GRIP_HALF[2] - HELD_HEIGHT
        return points_around(generator, centres, height, HAND_TO_OBJECT)

    def _hands_valid(self, hand: FloatArray) -> NDArray[np.bool_]:
        inside = self._regions.workspace.contains(hand, self._table)
        possible = inside & self._reachability.reachable(hand)
        return np.logical_and.reduce(possible, axis=-1)


def start_text() -> list[str]:
    """Return what the sampler guarantees, a sentence each."""

    def span(ends: tuple[float, float]) -> str:
        return f"{100 * ends[0]:g} to {100 * ends[1]:g} cm"

    across, along = (f"{100 * one:g} cm" for one in LOAD_SPREAD)
    return [
        f"The board lies on the table, its middle at x {DEPTH[0]:g} to {DEPTH[1]:g} m and y "
        f"{SIDEWAYS[0]:g} to {SIDEWAYS[1]:g} m of the world, turned by up to "
        f"{np.degrees(YAW[1]):.0f} degrees.",
        f"At its target it is level, {span(RISE)} above the table, each end {span(END_TO_TARGET)} "
        "from where it was.",
        f"The block lies on the board, up to {across} across and {along} along it from the middle.",
        f"Hands open, {span(HAND_TO_OBJECT)} from the ends and {span(ABOVE_GRIPS)} above the tops "
        "of the grips.",
        "Both ends, at the start, at the target and half-way, can be reached by their arms: the "
        "sampler looks each of them up.",
    ]
