"""Draws starts that a task can be solved from: hands, objects and targets in base frames.

Candidates are drawn in blocks and the first that keeps every rule is taken. Each rule is a
boolean mask over the block, so that what a start guarantees can be read here.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from saver_envs.reachability import ReachabilityMap
from saver_envs.scenes import BASE_SPACING, Scene
from saver_envs.tasks.regions import Regions

FloatArray = NDArray[np.float64]

#: Distance of a hand to its object, and of an object to its target (m).
HAND_TO_OBJECT = (0.10, 0.20)
OBJECT_TO_TARGET = (0.10, 0.25)
#: Objects and targets of different arms keep this many object widths apart.
CLEARANCE_WIDTHS = 1.5
#: Hands start this far from one another and from other arms' objects, horizontally (m): a hand's
#: width is 0.11 m.
HAND_CLEARANCE = 0.18
HAND_TO_OTHER_OBJECT = 0.12
#: Neighbours in a row start with their hands this far apart in y, uncrossed (m).
HAND_ORDER = 0.12
#: So are their objects, and their targets (m).
OBJECT_ORDER = 0.06
#: In a contested start the ways of two neighbours' objects cross, so that arms which ignore one
#: another usually collide. The first arm's object is drawn this near the middle line (m).
CONTEST_BAND = 0.20
#: To push an object its hand must get behind it: that far from its centre plus half its width (m).
PUSH_STANDOFF = 0.03
_BLOCK = 128
#: Contested starts are rarer among their candidates: larger blocks cost less in all.
_CONTESTED_BLOCK = 1024
_MOST_BLOCKS = 200
#: Large cubes may leave no room for a contest: after so many blocks the start is an ordinary one.
_MOST_CONTESTED_BLOCKS = 50
#: Candidates of a block for which hands are drawn.
_TRIES = 8
#: Direction from an object of the distance task to its neighbour's, about the y axis (rad).
_SEPARATION_HEADING = (np.pi / 6, 5 * np.pi / 6)


@dataclass(frozen=True)
class Start:
    """A start of one episode, every point in its arm's base frame, metres.

    :param hand: (arms, 3) tool positions.
    :param object: (arms, 3) object centres.
    :param target: (arms, 3) target points.
    """

    hand: FloatArray
    object: FloatArray
    target: FloatArray


@dataclass(frozen=True)
class StartRules:
    """What differs between tasks.

    :param hand_height: lowest and highest start of a hand above the table, metres.
    :param air_share: share of targets in the air.
    :param air_height: highest target, metres.
    :param success_threshold: no object starts this near its target, metres.
    :param pushes: whether a hand must have room behind its object.
    :param separation: required distance between the objects of two arms and between their targets,
        lowest and highest (m), or ``None``.
    :param contested_share: share of the starts of several arms in which the ways of two
        neighbours' hands meet.
    """

    hand_height: tuple[float, float]
    air_share: float
    air_height: float
    success_threshold: float
    pushes: bool
    separation: tuple[float, float] | None = None
    contested_share: float = 0.0


class StartSampler:
    """Draws starts for one scene.

    :param scene: the bench; gives object size and where the bases stand.
    :param regions: the boxes of objects and targets and the workspace of hands.
    :param reachability: the robot's map.
    :param rules: the task's rules.
    """

    def __init__(
        self, scene: Scene, regions: Regions, reachability: ReachabilityMap, rules: StartRules
    ) -> None:
        self._scene = scene
        self._regions = regions
        self._reachability = reachability
        self._rules = rules
        self._n_arms = scene.n_arms
        self._ordered = bool(np.all(scene.base_position[:, 0] == 0))
        # How far to its side an arm can have an object, where the box is nearest to it. Two arms
        # that hardly reach beyond the middle line (MICOs, 0.72 m apart) have nothing to contest.
        nearest = float(regions.object_lower[:, 0].min())
        sideways = max(regions.reach**2 - nearest**2, 0.0) ** 0.5
        self._contestable = sideways >= BASE_SPACING / 2 + OBJECT_ORDER

    def sample(self, generator: np.random.Generator) -> Start:
        """Draw a start.

        :param generator: the episode's source of randomness.
        :return: the start.
        :raises RuntimeError: when no candidate of many blocks keeps the rules, which means that
            the scene's regions or object size leave no room.
        """
        contest = self._draw_contest(generator)
        block = _BLOCK if contest is None else _CONTESTED_BLOCK
        for attempt in range(_MOST_BLOCKS):
            if attempt == _MOST_CONTESTED_BLOCKS:
                contest, block = None, _BLOCK
            objects, target = self._draw_ways(generator, block, contest)
            for candidate in np.flatnonzero(self._ways_valid(objects, target))[:_TRIES]:
                hand = self._draw_hands(generator, objects[candidate])
                valid = np.flatnonzero(self._hands_valid(hand, objects[candidate]))
                if valid.size:
                    return Start(hand[valid[0]], objects[candidate], target[candidate])
        raise RuntimeError(
            f"no start keeps the rules after {_MOST_BLOCKS} blocks of candidates: "
            f"objects of {self._scene.objects.size} m leave no room in the regions"
        )

    def _draw_contest(self, generator: np.random.Generator) -> int | None:
        """Draw whether the start is contested: the right one of two neighbours, or ``None``.

        Only arms in a row have neighbours; those round the table face one another. Arms of short
        reach have no common ground.
        """
        if self._n_arms == 1 or not self._ordered or not self._contestable:
            return None
        if generator.random() >= self._rules.contested_share:
            return None
        return int(generator.integers(self._n_arms - 1))

    def _draw_ways(
        self, generator: np.random.Generator, block: int, contest: int | None
    ) -> tuple[FloatArray, FloatArray]:
        """Draw a block of objects and targets, (block, arms, 3) each."""
        shape = (block, self._n_arms)
        rest = self._scene.object_rest_height
        lower, upper = self._regions.object_lower, self._regions.object_upper
        if contest is not None:
            lower = lower.copy()
            lower[contest, 1] = max(lower[contest, 1], upper[contest, 1] - 2 * CONTEST_BAND)
        objects = np.empty((*shape, 3))
        objects[..., :2] = generator.uniform(lower, upper, (*shape, 2))
        objects[..., 2] = rest
        if self._rules.separation is not None:
            self._separate(generator, objects)
        height = generator.uniform(rest, self._rules.air_height, shape)
        in_air = generator.random(shape) < self._rules.air_share
        target_height = np.where(in_air, height, rest)
        target = _at_distance(generator, objects, target_height, OBJECT_TO_TARGET)
        if contest is not None:
            self._cross(generator, objects, target, contest)
        if self._rules.separation is not None:
            self._separate(generator, target)
        return objects, target

    def _draw_hands(self, generator: np.random.Generator, objects: FloatArray) -> FloatArray:
        """Draw a block of hand positions (block, arms, 3) for one candidate's objects (arms, 3)."""
        height = generator.uniform(*self._rules.hand_height, (_BLOCK, self._n_arms))
        centres = np.broadcast_to(objects, (_BLOCK, *objects.shape))
        return _at_distance(generator, centres, height, HAND_TO_OBJECT)

    def _separate(self, generator: np.random.Generator, points: FloatArray) -> None:
        """Move the points of later arms to the required distance from their predecessors."""
        assert self._rules.separation is not None
        base = self._scene.base_position
        for arm in range(1, self._n_arms):
            world = points[:, arm - 1] + base[arm - 1]
            rise = points[:, arm, 2] - world[:, 2]
            distance = generator.uniform(*self._rules.separation, len(points))
            run = np.sqrt(np.maximum(distance**2 - rise**2, 0.0))
            angle = generator.uniform(*_SEPARATION_HEADING, len(points))
            points[:, arm, 0] = world[:, 0] + run * np.cos(angle) - base[arm, 0]
            points[:, arm, 1] = world[:, 1] + run * np.sin(angle) - base[arm, 1]

    def _cross(
        self, generator: np.random.Generator, objects: FloatArray, target: FloatArray, contest: int
    ) -> None:
        """Move the way of the left neighbour's object so that it crosses the right one's."""
        base = self._scene.base_position[:, :2]
        before = objects[:, contest, :2] + base[contest]
        after = target[:, contest, :2] + base[contest]
        meeting = before + generator.random((len(objects), 1)) * (after - before)
        left = contest + 1
        way = target[:, left, :2] - objects[:, left, :2]
        objects[:, left, :2] = meeting - generator.random((len(objects), 1)) * way - base[left]
        target[:, left, :2] = objects[:, left, :2] + way

    def _ways_valid(self, objects: FloatArray, target: FloatArray) -> NDArray[np.bool_]:
        """Say which objects and targets (block, arms, 3) keep every rule, (block,)."""
        valid = self._in_region(objects) & self._in_region(target)
        distance = np.linalg.norm(target - objects, axis=-1)
        valid &= (distance >= OBJECT_TO_TARGET[0]) & (distance <= OBJECT_TO_TARGET[1])
        valid &= distance > self._rules.success_threshold
        if self._rules.pushes:
            heading = (target - objects) / np.maximum(distance, 1e-9)[..., None]
            behind = objects - heading * (self._scene.objects.size / 2 + PUSH_STANDOFF)
            behind[..., 2] = self._rules.hand_height[0]
            valid &= self._hand_can_be_at(behind)
        per_start: NDArray[np.bool_] = np.logical_and.reduce(valid, axis=-1)
        clearance = CLEARANCE_WIDTHS * self._scene.objects.size
        world_objects, world_target = self._to_world(objects), self._to_world(target)
        for first, second in combinations(range(self._n_arms), 2):
            for one in (world_objects, world_target):
                for other in (world_objects, world_target):
                    per_start &= _apart(one[:, first], other[:, second]) >= clearance
            if self._ordered:
                for points in (world_objects, world_target):
                    per_start &= points[:, second, 1] - points[:, first, 1] >= OBJECT_ORDER
            if self._rules.pushes:
                per_start &= self._one_can_go_first(world_objects, world_target, first, second)
            if self._rules.separation is not None:
                low, high = self._rules.separation
                for points in (world_objects, world_target):
                    gap = _apart(points[:, first], points[:, second])
                    per_start &= (gap >= low) & (gap <= high)
        return per_start

    def _one_can_go_first(
        self, objects: FloatArray, target: FloatArray, first: int, second: int
    ) -> NDArray[np.bool_]:
        """Say where one of two arms can finish without blocking the other, (block,).

        Its way is clear of the other's object, and its target is clear of the other's way.
        """
        clearance = CLEARANCE_WIDTHS * self._scene.objects.size

        def goes_first(one: int, other: int) -> NDArray[np.bool_]:
            own_way = _to_segment(objects[:, other], objects[:, one], target[:, one])
            others_way = _to_segment(target[:, one], objects[:, other], target[:, other])
            clear: NDArray[np.bool_] = (own_way >= clearance) & (others_way >= clearance)
            return clear

        return goes_first(first, second) | goes_first(second, first)

    def _hands_valid(self, hand: FloatArray, objects: FloatArray) -> NDArray[np.bool_]:
        """Say which hands (block, arms, 3) may start beside objects (arms, 3), (block,)."""
        valid: NDArray[np.bool_] = np.logical_and.reduce(self._hand_can_be_at(hand), axis=-1)
        world_hand, world_objects = self._to_world(hand), self._to_world(objects)
        for first, second in combinations(range(self._n_arms), 2):
            for arm, other in ((first, second), (second, first)):
                gap = _horizontally_apart(world_hand[:, arm], world_objects[other])
                valid &= gap >= HAND_TO_OTHER_OBJECT
            gap = _horizontally_apart(world_hand[:, first], world_hand[:, second])
            valid &= gap >= HAND_CLEARANCE
            if self._ordered:
                valid &= world_hand[:, second, 1] - world_hand[:, first, 1] >= HAND_ORDER
        return valid

    def _to_world(self, points: FloatArray) -> FloatArray:
        """Turn base-frame points (..., arms, 3) into world-frame ones."""
        rotation, position = self._scene.base_rotation, self._scene.base_position
        turned: FloatArray = np.sum(rotation * points[..., None, :], axis=-1) + position
        return turned

    def _in_region(self, points: FloatArray) -> NDArray[np.bool_]:
        """Points inside their box, within reach, and reachable by the tool, (block, arms)."""
        horizontal = points[..., :2]
        inside = (horizontal >= self._regions.object_lower) & (
            horizontal <= self._regions.object_upper
        )
        near = np.hypot(points[..., 0], points[..., 1]) <= self._regions.reach
        return inside.all(axis=-1) & near & self._reachability.reachable(points)

    def _hand_can_be_at(self, points: FloatArray) -> NDArray[np.bool_]:
        inside = self._regions.workspace.contains(points)
        return inside & self._reachability.reachable(points)


def _at_distance(
    generator: np.random.Generator,
    centre: FloatArray,
    height: FloatArray,
    distance: tuple[float, float],
) -> FloatArray:
    """Points (block, arms, 3) at given heights, at a random distance and angle from centres.

    The distance is that in space; where the height alone exceeds it the point lies above.
    """
    rise = height - centre[..., 2]
    least = np.clip(np.abs(rise), distance[0], distance[1])
    apart = generator.uniform(least, distance[1])
    run = np.sqrt(np.maximum(apart**2 - rise**2, 0.0))
    angle = generator.uniform(0.0, 2 * np.pi, apart.shape)
    return np.stack(
        [centre[..., 0] + run * np.cos(angle), centre[..., 1] + run * np.sin(angle), height],
        axis=-1,
    )


def _apart(first: FloatArray, second: FloatArray) -> FloatArray:
    return np.linalg.norm(first - second, axis=-1)


def _horizontally_apart(first: FloatArray, second: FloatArray) -> FloatArray:
    return np.linalg.norm((first - second)[..., :2], axis=-1)


def _to_segment(points: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """Distance (block,) of points (block, 3) to segments, metres."""
    way = end - start
    share = np.sum((points - start) * way, axis=-1) / np.maximum(np.sum(way * way, axis=-1), 1e-9)
    return _apart(points, start + np.clip(share, 0.0, 1.0)[..., None] * way)
