"""Draws solvable starts: hands, objects and targets in base frames.

Candidates are drawn in blocks, and the first one that satisfies every rule is used. Each rule is a
boolean mask over the block.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from saver_envs.control import length
from saver_envs.reachability import ReachabilityMap
from saver_envs.scenes import BASE_SPACING, Scene
from saver_envs.tasks.contract import NoStart, Start
from saver_envs.tasks.regions import Regions
from saver_envs.validation import require_share

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
#: Share of contested starts, set so that two arms which ignore one another fail often enough (see
#: docs/decisions.md).
CONTESTED_SHARE = 0.4
#: In a contested start the ways of two neighbours' objects cross, so that arms which ignore one
#: another usually collide. The first arm's object is drawn this near the middle line (m).
CONTEST_BAND = 0.20
#: Hardly any ways of larger cubes (m) that cross leave room to push both: none of 30 contested
#: starts was found with 8 cm in 50 blocks of candidates, a quarter with 7 cm.
CONTEST_SIZE = 0.07
#: To push an object, its hand must get behind it: this far from its face (m).
PUSH_STANDOFF = 0.03
#: Higher objects (m) meet palms, and the wrist of a pitched hand, which has to be further behind.
BELOW_WRIST = 0.075
_BLOCK = 128
#: Of so many crossings of two ways about fourteen satisfy the rules between two arms. Each is tried
#: in so many places; with more, crossings that fit in few places would be overrepresented.
_CROSSINGS, _PLACES = 4096, 4
_MOST_BLOCKS = 200
#: Large cubes may leave no room for a contest: after so many blocks of two arms, and of more, an
#: ordinary start is drawn.
_MOST_CONTESTED_BLOCKS = (50, 100)
#: Blocks of which all arms' ways are drawn together, by number of arms. With more than two arms few
#: keep every rule, so the crossing ways are drawn first from then on, and the others around them.
#: Three arms begin like two, which keeps the starts that policies were measured on.
_JOINT_BLOCKS = {2: 50, 3: 50, 4: 2}
#: Candidates of a block for which hands are drawn.
_TRIES = 8
#: Direction from an object of the distance task to its neighbour's, about the y axis (rad).
_SEPARATION_HEADING = (np.pi / 6, 5 * np.pi / 6)


@dataclass(frozen=True)
class TableStart(Start):
    """A start of one episode, every point in its arm's base frame, metres.

    :param object: (arms, 3) cube centres.
    :param target: (arms, 3) target points.
    :param held: (arms,) whether the hand holds its cube, which is then not at ``object``.
    :param object_size: edge of the cubes, metres.
    """

    object: FloatArray
    target: FloatArray
    held: NDArray[np.bool_]
    object_size: float


@dataclass(frozen=True)
class StartRules:
    """What differs between tasks; fields that are named like a task's options have their values.

    :param object_size: edge of the cubes, metres.
    :param hand_height: lowest and highest start of a hand above the table, metres.
    :param air_share: share of targets in the air.
    :param air_height: highest target, metres.
    :param success_threshold: no object starts nearer to its target, metres.
    :param pushes: whether a hand must have room behind its object.
    :param separation: required distance between the objects of two arms and between their targets,
        lowest and highest (m), or ``None``.
    :param contested_share: share of the starts of several arms in which the ways of two
        neighbours' hands meet.
    :param in_hand_probability: that an arm starts with its cube in hand.
    :param table_height: height of the table above the arms' bases, metres.
    """

    object_size: float
    hand_height: tuple[float, float]
    air_height: float
    success_threshold: float
    air_share: float = 0.0
    pushes: bool = False
    separation: tuple[float, float] | None = None
    contested_share: float = 0.0
    in_hand_probability: float = 0.0
    table_height: float = 0.0

    def __post_init__(self) -> None:
        for name in ("contested_share", "in_hand_probability"):
            require_share(name, getattr(self, name))


class StartSampler:
    """Draws starts for one scene.

    :param scene: says where the bases stand.
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
        #: Height of a resting cube's centre, metres.
        self._rest = rules.object_size / 2 + rules.table_height
        self._n_arms = scene.n_arms

    @cached_property
    def _ordered(self) -> bool:
        """Whether the arms stand in a row."""
        return not self._scene.base_position[:, 0].any()

    @cached_property
    def contestable(self) -> bool:
        """Whether starts can be contested.

        Only arms in a row have neighbours: those around the table face one another. Arms of short
        reach share no region.
        """
        roomy = not self._rules.pushes or self._rules.object_size < CONTEST_SIZE
        if self._n_arms == 1 or not (roomy and self._ordered):
            return False
        # How far to its side an arm can have an object, where the box is nearest to it. Two arms
        # that hardly reach beyond the middle line (MICOs, 0.72 m apart) have nothing to contest.
        nearest = float(self._regions.object_lower[:, 0].min())
        sideways = max(self._regions.reach**2 - nearest**2, 0.0) ** 0.5
        return sideways >= BASE_SPACING / 2 + OBJECT_ORDER

    def sample(self, generator: np.random.Generator) -> TableStart:
        """Draw a start.

        :param generator: the episode's source of randomness.
        :return: the start.
        :raises NoStart: when no candidate of many blocks satisfies the rules: the regions or
            the object size leave no room.
        """
        contest = None  # or the right one of two neighbours whose ways cross
        if self.contestable and generator.random() < self._rules.contested_share:
            contest = int(generator.integers(self._n_arms - 1))
        joint = _JOINT_BLOCKS.get(self._n_arms, 0)
        for attempt in range(_MOST_BLOCKS):
            if attempt == _MOST_CONTESTED_BLOCKS[self._n_arms > 2]:
                contest = None
            objects, target = self._draw_ways(generator)
            if contest is not None:
                objects, target = self._crossed(generator, objects, target, contest)
                if attempt >= joint:
                    objects, target = self._surrounded(generator, objects, target, contest)
            for candidate in np.flatnonzero(self._ways_valid(objects, target))[:_TRIES]:
                hand = self._draw_hands(generator, objects[candidate])
                valid = np.flatnonzero(self._hands_valid(hand, objects[candidate]))
                if valid.size:
                    held = np.zeros(self._n_arms, dtype=bool)
                    if (probability := self._rules.in_hand_probability) > 0:
                        held = generator.random(self._n_arms) < probability
                    size, places = self._rules.object_size, (objects[candidate], target[candidate])
                    return TableStart(hand[valid[0]], *places, held, size)
        raise NoStart(
            f"no start keeps the rules after {_MOST_BLOCKS} blocks of candidates: "
            f"objects of {self._rules.object_size} m leave no room in the regions"
        )

    def _draw_ways(self, generator: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Draw a block of objects and targets, (block, arms, 3) each."""
        shape = (_BLOCK, self._n_arms)
        lower, upper = self._regions.object_lower, self._regions.object_upper
        objects = np.empty((*shape, 3))
        objects[..., :2] = generator.uniform(lower, upper, (*shape, 2))
        objects[..., 2] = self._rest
        if self._rules.separation is not None:
            self._separate(generator, objects)
        target = self._draw_target(generator, objects)
        if self._rules.separation is not None:
            self._separate(generator, target)
        return objects, target

    def _draw_target(self, generator: np.random.Generator, objects: FloatArray) -> FloatArray:
        """Draw a target for each object (..., 3)."""
        rest = self._rest
        shape = objects.shape[:-1]
        height = generator.uniform(rest, self._rules.air_height + self._rules.table_height, shape)
        in_air = generator.random(shape) < self._rules.air_share
        return points_around(generator, objects, np.where(in_air, height, rest), OBJECT_TO_TARGET)

    def _draw_hands(self, generator: np.random.Generator, objects: FloatArray) -> FloatArray:
        """Draw a block of hand positions (block, arms, 3) for one candidate's objects (arms, 3)."""
        height = generator.uniform(*self._rules.hand_height, (_BLOCK, self._n_arms))
        height += self._rules.table_height
        centres = np.broadcast_to(objects, (_BLOCK, *objects.shape))
        return points_around(generator, centres, height, HAND_TO_OBJECT)

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

    def _crossed(
        self, generator: np.random.Generator, objects: FloatArray, target: FloatArray, contest: int
    ) -> tuple[FloatArray, FloatArray]:
        """Return a block whose ways of two neighbours are replaced by ways that cross.

        The rules between two arms do not depend on where both are: many crossings are drawn about
        the right object, and those that keep these rules are laid on the table, each in some
        places. As many are returned, at most the block.
        """
        ways = np.repeat(self._draw_crossings(generator), _PLACES, axis=0)[: len(objects)]
        lower, upper = self._regions.object_lower[contest], self._regions.object_upper[contest]
        lower = np.array([lower[0], max(lower[1], upper[1] - 2 * CONTEST_BAND)])
        place = np.zeros((len(ways), 1, 3))
        place[..., :2] = generator.uniform(lower, upper, (len(ways), 1, 2))
        objects, target = objects[: len(ways)], target[: len(ways)]
        base = self._scene.base_position
        for index, arm in enumerate((contest, contest + 1)):
            way = ways[:, index] + place + (base[contest] - base[arm])
            objects[:, arm], target[:, arm] = way[:, 0], way[:, 1]
        return objects, target

    def _surrounded(
        self, generator: np.random.Generator, objects: FloatArray, target: FloatArray, contest: int
    ) -> tuple[FloatArray, FloatArray]:
        """Return blocks in which crossing ways stay, and the other arms' ways are drawn again.

        :param objects: (k, arms, 3), of which the arms ``contest`` and ``contest + 1`` cross.
        :param target: (k, arms, 3).
        :return: a block for each of the crossings that keep the rules, at most :data:`_TRIES`.
        """
        pair = (contest, contest + 1)
        kept = np.flatnonzero(self._ways_valid(objects, target, pair))[:_TRIES]
        ways = np.empty((2, len(kept), _BLOCK, self._n_arms, 3))
        for index, one in enumerate(kept):
            ways[:, index] = self._draw_ways(generator)
            ways[0, index, :, pair] = objects[one, pair, None]
            ways[1, index, :, pair] = target[one, pair, None]
        objects, target = ways.reshape(2, -1, self._n_arms, 3)
        return objects, target

    def _draw_crossings(self, generator: np.random.Generator) -> FloatArray:
        """Draw ways of a right and a left object that cross and keep the rules between two arms.

        :return: (k, 2, 2, 3): arm, object and target; horizontally from the right object.
        """
        objects = np.zeros((_CROSSINGS, 2, 3))
        objects[..., 2] = self._rest
        target = self._draw_target(generator, objects)
        passed = generator.random((_CROSSINGS, 2, 1))  # shares of the ways where they meet
        met = passed * (target - objects)[..., :2]
        shift = met[:, 0] - met[:, 1]
        # Most candidates fail this test, so it runs first.
        turn = target[:, 1, 1] - target[:, 0, 1]
        kept = np.flatnonzero(np.minimum(shift[:, 1], shift[:, 1] + turn) >= OBJECT_ORDER)
        ways = np.stack([objects[kept], target[kept]], axis=2)
        ways[:, 1, :, :2] += shift[kept, None]
        return ways[self._pair_valid(ways[:, 0], ways[:, 1])]

    def _ways_valid(
        self, objects: FloatArray, target: FloatArray, arms: tuple[int, ...] | None = None
    ) -> NDArray[np.bool_]:
        """Return which objects and targets (block, arms, 3) keep every rule, (block,).

        :param arms: those whose rules are asked for; all by default.
        """
        chosen = list(range(self._n_arms) if arms is None else arms)
        ways = np.stack([objects, target], axis=1)
        valid = np.logical_and.reduce(self._in_region(ways), axis=1)
        way = target - objects
        distance = length(way)
        valid &= (distance >= OBJECT_TO_TARGET[0]) & (distance <= OBJECT_TO_TARGET[1])
        valid &= distance > self._rules.success_threshold
        per_start: NDArray[np.bool_] = np.logical_and.reduce(valid[:, chosen], axis=-1)
        if self._rules.pushes:
            standoff = self._rules.object_size / 2 + PUSH_STANDOFF
            unit = way / np.maximum(distance, 1e-9)[..., None]
            behind = ways - (standoff * unit)[:, None]
            behind[..., 2] = self._rules.hand_height[0] + self._rules.table_height
            possible = self._hand_can_be_at(self._behind_wrist(behind[:, 0], unit))[:, chosen]
            per_start &= np.logical_and.reduce(possible, axis=-1)
            if self._ordered:
                # The last centimetres of a push need not be made. Round the table arms face one
                # another and any two of them reach nearly all of it.
                needed = unit * np.minimum(distance, self._rules.success_threshold)[..., None]
                behind[:, 1] -= needed
                per_start &= self._needs_every_arm(self._scene.to_world(behind), chosen)
        world = self._scene.to_world(ways)
        for first, second in combinations(chosen, 2):
            per_start &= self._pair_valid(world[:, :, first], world[:, :, second])
        return per_start

    def _behind_wrist(self, hand: FloatArray, way: FloatArray) -> FloatArray:
        """Return where hands behind objects have to be so that their wrists do not meet these.

        :param hand: (block, arms, 3) where upright hands would be, metres.
        :param way: (block, arms, 3) unit vectors of the pushes.
        """
        robot = self._scene.robot
        if self._rules.object_size <= BELOW_WRIST or robot.wrist_lead == 0:
            return hand
        away = length(hand[..., :2])
        inward = -(hand[..., :2] * way[..., :2]).sum(axis=-1) / np.maximum(away, 1e-9)
        lead = robot.wrist_lead * np.maximum(away - robot.upright_at, 0.0)
        return hand - (lead * np.maximum(inward, 0.0))[..., None] * way

    def _needs_every_arm(self, behind: FloatArray, arms: list[int]) -> NDArray[np.bool_]:
        """Return where no arm has room for all of another's push, (block,).

        :param behind: (block, 2, arms, 3) hands behind objects and behind objects at their targets,
            world frame.
        :param arms: those that count.
        """
        valid = np.ones(len(behind), dtype=bool)
        for arm in arms:
            mine = self._scene.to_bases(np.broadcast_to(behind[:, :, arm, None], behind.shape))
            within = np.logical_and.reduce(self._hand_can_be_at(mine), axis=1)
            within[:, arm] = False
            valid &= ~np.logical_or.reduce(within[:, arms], axis=-1)
        return valid

    def _pair_valid(self, first: FloatArray, second: FloatArray) -> NDArray[np.bool_]:
        """Return which ways keep the rules between two arms, (block,).

        :param first: (block, 2, 3) object and target of one arm, world frame.
        :param second: the same of an arm to its left.
        """
        gaps = length(first[:, :, None] - second[:, None])
        clearance = CLEARANCE_WIDTHS * self._rules.object_size
        valid: NDArray[np.bool_] = np.logical_and.reduce(gaps >= clearance, axis=(1, 2))
        if self._ordered:
            apart = second[..., 1] - first[..., 1]
            valid &= np.logical_and.reduce(apart >= OBJECT_ORDER, axis=1)
        if self._rules.pushes:
            valid &= self._one_can_go_first(first, second)
        if self._rules.separation is not None:
            low, high = self._rules.separation
            alike = gaps.diagonal(axis1=1, axis2=2)
            valid &= np.logical_and.reduce((alike >= low) & (alike <= high), axis=1)
        return valid

    def _one_can_go_first(self, first: FloatArray, second: FloatArray) -> NDArray[np.bool_]:
        """Return where one of two arms can finish without blocking the other, (block,).

        Its way is clear of the other's object, and its target is clear of the other's way.

        :param first: (block, 2, 3) object and target of one arm, world frame.
        :param second: the same of the other.
        """
        points = np.concatenate([first, second], axis=1)
        object_1, target_1, object_2, target_2 = range(4)
        # The first arm's way and target, if it goes first, then the second's.
        gaps = distance_to_segment(
            points[:, (object_2, target_1, object_1, target_2)],
            points[:, (object_1, object_2, object_2, object_1)],
            points[:, (target_1, target_2, target_2, target_1)],
        )
        clear = gaps >= CLEARANCE_WIDTHS * self._rules.object_size
        return (clear[:, 0] & clear[:, 1]) | (clear[:, 2] & clear[:, 3])

    def _hands_valid(self, hand: FloatArray, objects: FloatArray) -> NDArray[np.bool_]:
        """Return which hands (block, arms, 3) may start beside objects (arms, 3), (block,)."""
        possible = self._hand_can_be_at(hand)
        valid: NDArray[np.bool_] = np.logical_and.reduce(possible, axis=-1)
        world_hand, world_objects = self._scene.to_world(hand), self._scene.to_world(objects)
        for first, second in combinations(range(self._n_arms), 2):
            pair = world_hand[:, [first, second]]
            to_other = length((pair - world_objects[[second, first]])[..., :2])
            valid &= np.logical_and.reduce(to_other >= HAND_TO_OTHER_OBJECT, axis=-1)
            apart = pair[:, 1, :2] - pair[:, 0, :2]
            valid &= length(apart) >= HAND_CLEARANCE
            if self._ordered:
                valid &= apart[:, 1] >= HAND_ORDER
        return valid

    def _in_region(self, points: FloatArray) -> NDArray[np.bool_]:
        """Points (..., arms, 3) in their box, within reach, and reachable by the tool."""
        level = points[..., :2]
        inside = (level >= self._regions.object_lower) & (level <= self._regions.object_upper)
        valid: NDArray[np.bool_] = np.logical_and.reduce(inside, axis=-1)
        return valid & (length(level) <= self._regions.reach) & self._reachability.reachable(points)

    def _hand_can_be_at(self, points: FloatArray) -> NDArray[np.bool_]:
        inside = self._regions.workspace.contains(points, self._rules.table_height)
        return inside & self._reachability.reachable(points)


def points_around(
    generator: np.random.Generator,
    centre: FloatArray,
    height: FloatArray,
    distance: tuple[float, float],
) -> FloatArray:
    """Points (block, arms, 3) at given heights, at a random distance and angle from centres.

    The distance is that in space; a point whose height alone exceeds it lies above its centre.
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


def distance_to_segment(points: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """Distance (...) of points (..., d) to segments, metres."""
    way, lever = end - start, points - start
    share = (lever * way).sum(axis=-1) / np.maximum((way * way).sum(axis=-1), 1e-9)
    share = np.minimum(np.maximum(share, 0.0), 1.0)
    return length(lever - share[..., None] * way)


def start_text(n_arms: int, rules: StartRules, boxes: Regions) -> list[str]:
    """Return what the sampler guarantees, a sentence each.

    :param n_arms: number of arms.
    :param rules: of the starts.
    :param boxes: of hands, objects and targets.
    """
    lines = [
        f"A cube {_span(HAND_TO_OBJECT)} from its hand, its target {_span(OBJECT_TO_TARGET)} from "
        "the cube.",
        *_boxes(boxes),
        _hands(rules),
        _targets(rules),
    ]
    if rules.pushes:
        lines.append("Behind each cube there is room for the hand that is to push it.")
    if n_arms > 1:
        lines += _several_arms(rules)
    lines.append("Hands, cubes and targets can be reached: the sampler looks each of them up.")
    return lines


def _boxes(boxes: Regions) -> list[str]:
    """Describe each arm's box; one line for all where they are alike."""
    texts = [
        f"x {lower[0]:g} to {upper[0]:g} m, y {lower[1]:g} to {upper[1]:g} m"
        for lower, upper in zip(boxes.object_lower, boxes.object_upper, strict=True)
    ]
    reach = f"at most {boxes.reach:g} m from the base"
    if len(set(texts)) == 1:
        return [f"Cubes and targets in {texts[0]}, {reach}."]
    return [f"Arm {arm}: cube and target in {box}, {reach}." for arm, box in enumerate(texts)]


def _hands(rules: StartRules) -> str:
    low, high = rules.hand_height
    if low == high:
        return f"Hands closed, {100 * low:g} cm above the table."
    return f"Hands open, {100 * low:g} to {100 * high:g} cm above the table."


def _targets(rules: StartRules) -> str:
    if rules.air_share == 0:
        return "Targets on the table."
    return (
        f"{rules.air_share:.0%} of the targets in the air, up to {100 * rules.air_height:g} cm; "
        "the others on the table."
    )


def _several_arms(rules: StartRules) -> list[str]:
    lines = [
        f"Cubes and targets of different arms are at least {CLEARANCE_WIDTHS:g} cube widths apart, "
        f"hands {100 * HAND_CLEARANCE:g} cm from one another and "
        f"{100 * HAND_TO_OTHER_OBJECT:g} cm from other arms' cubes."
    ]
    if rules.separation is not None:
        low, high = rules.separation
        lines.append(f"Both cubes, and both targets, {low:g} to {high:g} m apart.")
    elif rules.contested_share > 0:
        lines.append(
            f"In {rules.contested_share:.0%} of the episodes the ways of two neighbours' cubes "
            "cross, so that the arms must give way; in the others hardly ever. The share holds for "
            "2, 3 and 4 arms."
        )
    return lines


def _span(span: tuple[float, float]) -> str:
    return f"{100 * span[0]:g} to {100 * span[1]:g} cm"
