"""Draws starts that a task can be solved from: hands, objects and targets in base frames.

Candidates are drawn in blocks and the first that keeps every rule is taken. Each rule is a
boolean mask over the block, so that what a start guarantees can be read here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saver_envs.reachability import ReachabilityMap
from saver_envs.scenes import Scene
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
#: To push an object its hand must get behind it: that far from its centre plus half its width (m).
PUSH_STANDOFF = 0.03
_BLOCK = 128
_MOST_BLOCKS = 200


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
    """

    hand_height: tuple[float, float]
    air_share: float
    air_height: float
    success_threshold: float
    pushes: bool
    separation: tuple[float, float] | None = None


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

    def sample(self, generator: np.random.Generator) -> Start:
        """Draw a start.

        :param generator: the episode's source of randomness.
        :return: the start.
        :raises RuntimeError: when no candidate of many blocks keeps the rules, which means that
            the scene's regions or object size leave no room.
        """
        for _ in range(_MOST_BLOCKS):
            candidates = self._draw(generator)
            valid = np.flatnonzero(self._valid(candidates))
            if valid.size:
                first = valid[0]
                return Start(
                    candidates.hand[first], candidates.object[first], candidates.target[first]
                )
        raise RuntimeError(
            f"no start keeps the rules after {_MOST_BLOCKS * _BLOCK} candidates: "
            f"objects of {self._scene.objects.size} m leave no room in the regions"
        )

    def _draw(self, generator: np.random.Generator) -> Start:
        """Draw a block of candidates; arrays have shape (block, arms, 3)."""
        shape = (_BLOCK, self._n_arms)
        rest = self._scene.object_rest_height
        lower, upper = self._regions.object_lower, self._regions.object_upper
        objects = np.empty((*shape, 3))
        objects[..., :2] = generator.uniform(lower, upper, (*shape, 2))
        objects[..., 2] = rest
        if self._rules.separation is not None:
            self._separate(generator, objects, np.pi / 2, np.pi / 3)
        height = generator.uniform(rest, self._rules.air_height, shape)
        in_air = generator.random(shape) < self._rules.air_share
        target_height = np.where(in_air, height, rest)
        target = _at_distance(generator, objects, target_height, OBJECT_TO_TARGET)
        if self._rules.separation is not None:
            self._separate(generator, target, np.pi / 2, np.pi / 3)
        hand_height = generator.uniform(*self._rules.hand_height, shape)
        hand = _at_distance(generator, objects, hand_height, HAND_TO_OBJECT)
        return Start(hand, objects, target)

    def _separate(
        self, generator: np.random.Generator, points: FloatArray, heading: float, spread: float
    ) -> None:
        """Move the points of later arms to the required distance from their predecessors."""
        assert self._rules.separation is not None
        base = self._scene.base_position
        for arm in range(1, self._n_arms):
            world = points[:, arm - 1] + base[arm - 1]
            rise = points[:, arm, 2] - world[:, 2]
            distance = generator.uniform(*self._rules.separation, _BLOCK)
            run = np.sqrt(np.maximum(distance**2 - rise**2, 0.0))
            angle = generator.uniform(heading - spread, heading + spread, _BLOCK)
            points[:, arm, 0] = world[:, 0] + run * np.cos(angle) - base[arm, 0]
            points[:, arm, 1] = world[:, 1] + run * np.sin(angle) - base[arm, 1]

    def _valid(self, start: Start) -> NDArray[np.bool_]:
        """Say which candidates of a block keep every rule, shape (block,)."""
        valid = self._in_region(start.object) & self._in_region(start.target)
        distance = np.linalg.norm(start.target - start.object, axis=-1)
        valid &= (distance >= OBJECT_TO_TARGET[0]) & (distance <= OBJECT_TO_TARGET[1])
        valid &= distance > self._rules.success_threshold
        valid &= self._hand_can_be_at(start.hand)
        if self._rules.pushes:
            direction = (start.target - start.object) / distance[..., None]
            standoff = self._scene.objects.size / 2 + PUSH_STANDOFF
            behind = start.object - standoff * direction
            behind[..., 2] = start.hand[..., 2]
            valid &= self._hand_can_be_at(behind)
        per_start: NDArray[np.bool_] = valid.all(axis=-1)
        if self._n_arms > 1:
            per_start &= self._clear_of_others(start)
        return per_start

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

    def _clear_of_others(self, start: Start) -> NDArray[np.bool_]:
        """Rules between arms, in the world frame."""
        to_world = self._scene.base_rotation
        hand, objects, target = (
            np.einsum("aij,kaj->kai", to_world, points) + self._scene.base_position
            for points in (start.hand, start.object, start.target)
        )
        clearance = CLEARANCE_WIDTHS * self._scene.objects.size
        clear = np.ones(_BLOCK, dtype=bool)
        for first in range(self._n_arms):
            for second in range(self._n_arms):
                if first == second:
                    continue
                clear &= _apart(objects[:, first], target[:, second]) >= clearance
                clear &= _horizontally_apart(hand[:, first], objects[:, second]) >= (
                    HAND_TO_OTHER_OBJECT
                )
                if first > second:
                    continue
                clear &= _apart(objects[:, first], objects[:, second]) >= clearance
                clear &= _apart(target[:, first], target[:, second]) >= clearance
                clear &= _horizontally_apart(hand[:, first], hand[:, second]) >= HAND_CLEARANCE
                if self._ordered:
                    clear &= hand[:, second, 1] - hand[:, first, 1] >= HAND_ORDER
                if self._rules.separation is not None:
                    low, high = self._rules.separation
                    for points in (objects, target):
                        gap = _apart(points[:, first], points[:, second])
                        clear &= (gap >= low) & (gap <= high)
        return clear


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
