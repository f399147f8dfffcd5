"""Coordination of arms in a row: they simulate plans ahead and follow the best.

A plan says which of two neighbours goes first, whether the other follows close behind or waits on
its own side, and on which side each hand passes its cube. Every plan is simulated in a simplified
world (discs that move discs) under the rules by which the arms then act, and rated by success,
contact and time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from saver_envs.control import shortened
from saver_envs.episodes import DEFAULT_SPEED, Settings
from saver_envs.experts.blocks import ArmView
from saver_envs.experts.expert import Expert
from saver_envs.experts.frozen import serves_all
from saver_envs.experts.geometry import FloatArray, length, way_round
from saver_envs.experts.skill import Skill
from saver_envs.scenes import base_poses
from saver_envs.tasks.contract import Task


@dataclass(frozen=True)
class Clearance:
    """How far apart in y two neighbours' hands must be, given their distance in x; measured.

    :param dx: x of the hand to the left less that of the hand to the right, metres, rising.
    :param dy: least y of the hand to the left less that of the hand to the right, metres.
    """

    dx: tuple[float, ...]
    dy: tuple[float, ...]

    def __call__(self, dx: FloatArray) -> FloatArray:
        """Return the least dy, metres."""
        return np.interp(dx, self.dx, self.dy)


#: Found by sampling postures of two Jacos: the wrists lie to one side of the hands, so a left hand
#: may pass far behind a right one, but not before it. Some room is added for arms in motion.
JACO_CLOSED = Clearance(
    (-0.25, -0.20, -0.15, -0.10, -0.05, 0.05, 0.08, 0.12),
    (0.02, 0.05, 0.085, 0.12, 0.135, 0.13, 0.10, -0.10),
)
#: Hands that hold cubes, side by side over targets as near as these may be.
JACO_HOLDING = Clearance(
    (-0.25, -0.20, -0.15, -0.10, -0.05, 0.05, 0.08, 0.12),
    (0.00, 0.04, 0.075, 0.10, 0.115, 0.115, 0.09, -0.10),
)
#: Hands of which one is open, found in the same way with tools 0.03 to 0.25 m high.
JACO_OPEN = Clearance(
    (-0.25, -0.20, -0.15, -0.10, -0.06, 0.05, 0.10, 0.14),
    (0.02, 0.08, 0.115, 0.13, 0.16, 0.16, 0.10, -0.05),
)


@dataclass(frozen=True)
class Plan:
    """One way to share the table; leading dimension (n,).

    :param first: (n, arms - 1) 1 where the right one of two neighbours goes first, 0 where the
        left one does.
    :param waits: (n,) 1 where those that follow wait on their own side, 0 where they go along.
    :param shoves: (n,) 1 where hands may brush other arms' cubes aside, 0 where they go round.
    :param side: (n, arms) way round the own cube, see :class:`PushSkill`.
    """

    first: FloatArray
    waits: FloatArray
    shoves: FloatArray
    side: FloatArray


Record = TypeVar("Record", ArmView, Plan)


class Coordinator:
    """Chooses among plans by simulating them, and follows the best.

    A plan is kept until another is better by a margin, which avoids switching between equally good
    plans.

    :param skill: what each arm does by itself.
    :param base: (arms, 2) base positions of a row along y, metres.
    :param closed: how close two closed hands may come.
    :param steps: actions to simulate ahead.
    """

    #: Extra distance that a following hand keeps for the leader's next step (m).
    BUFFER = 0.03
    #: Mean finger angles from which hands are closed, and up to which they are open (rad).
    CLOSED, OPEN = 0.75, 0.25
    #: Hands may hold their cubes this far beside the targets (m), which reach 0.05 m.
    SPREAD = 0.03
    #: Weights of a plan's cost: failure, a step in contact, the arms' mean time besides the
    #: longest.
    FAILS, CONTACT, MEAN_TIME = 200.0, 10.0, 0.3
    #: Weight of a step of touching another arm's cube, against that of touching its hand.
    BRUSH = 2.0
    #: Actions between comparisons of plans, and the margin by which another must be better.
    PERIOD, MARGIN = 5, 6.0

    def __init__(
        self,
        skill: Skill,
        base: FloatArray,
        closed: Clearance = JACO_CLOSED,
        steps: int = 50,
    ) -> None:
        self.skill = skill
        self.base = np.asarray(base)
        self.closed = closed
        self.steps = steps
        self._plans = self._all_plans(len(self.base))
        self._chosen = np.zeros(0, dtype=np.intp)
        self._age = np.zeros(0, dtype=np.intp)
        # Arms (n, arms) that have been done, and keep their cubes.
        self._served = np.zeros((0, len(self.base)), dtype=bool)

    def actions(self, view: ArmView) -> FloatArray:
        """Return the arms' actions (n, arms, 3 or 4) in [-1, 1]."""
        if len(self._age) != len(view.begins):
            self._chosen, self._age = np.zeros((2, len(view.begins)), dtype=np.intp)
            self._served = np.zeros(view.tool.shape[:2], dtype=bool)
        view = self._spread(view)
        self._age = np.where(view.begins, 0, self._age + 1)
        self._served = self._update(view, self._served & ~view.begins[:, None])
        rows = np.flatnonzero(self._age % self.PERIOD == 0)
        if rows.size and self.plans > 1:
            self._choose(view, rows, view.begins[rows])
        return self._act(view, _rows(self._plans, self._chosen), self._served)

    def _update(self, view: ArmView, served: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which arms (n, arms) are done, or were and have only given way since."""
        return self.skill.finished(view) | (served & self.skill.keeps(view))

    @property
    def plans(self) -> int:
        """Number of plans."""
        return len(self._plans.waits)

    def follow(self, view: ArmView, chosen: NDArray[np.intp]) -> FloatArray:
        """Return the actions (n, arms, 3 or 4) under given plans.

        :param view: what the arms see.
        :param chosen: (n,) plans, from 0 to :attr:`plans` - 1.
        """
        view = self._spread(view)
        return self._act(view, _rows(self._plans, chosen), self.skill.finished(view))

    def _least(self, view: ArmView, right: int, dx: FloatArray) -> FloatArray:
        """Least distance in y (n,) of hand ``right`` and its left neighbour, metres."""
        widest = view.fingers[:, right : right + 2].mean(axis=-1).min(axis=-1)
        share = np.clip((self.CLOSED - widest) / (self.CLOSED - self.OPEN), 0.0, 1.0)
        return self.closed(dx) + share * (JACO_OPEN(dx) - self.closed(dx))

    def _spread(self, view: ArmView) -> ArmView:
        """Move targets apart that are so near each other that two hands do not fit."""
        if self.skill.low:
            return view
        target = view.target.copy()
        for right in range(target.shape[1] - 1):
            gap = target[:, right + 1, :2] - target[:, right, :2]
            gap = gap + self.base[right + 1] - self.base[right]
            lack = self.closed(gap[:, 0]) + self.BUFFER - gap[:, 1]
            shift = np.clip(lack / 2, 0, self.SPREAD)
            target[:, right, 1] -= shift
            target[:, right + 1, 1] += shift
        return replace(view, target=target)

    def _choose(self, view: ArmView, rows: NDArray[np.intp], fresh: NDArray[np.bool_]) -> None:
        """Compare plans in episodes ``rows``; ``fresh`` ones have no plan yet."""
        left = self.steps - self._age[rows] % self.steps
        cost = self._costs(_rows(view, rows), left, self._served[rows])
        kept = np.take_along_axis(cost, self._chosen[rows, None], axis=1)[:, 0]
        better = fresh | (cost.min(axis=1) < kept - self.MARGIN)
        self._chosen[rows] = np.where(better, cost.argmin(axis=1), self._chosen[rows])

    def _costs(
        self, view: ArmView, left: NDArray[np.intp], served: NDArray[np.bool_]
    ) -> FloatArray:
        """Return the cost of each plan, (n, plans).

        :param view: what the arms see.
        :param left: (n,) actions left in the episodes.
        :param served: (n, arms) arms that have been done, and keep their cubes.
        """
        n, count = len(view.tool), self.plans
        plan = _rows(self._plans, np.tile(np.arange(count), n))
        index = np.repeat(np.arange(n), count)
        cost = self._cost(_rows(view, index), plan, left[index], served[index])
        return cost.reshape(n, count)

    def _all_plans(self, arms: int) -> Plan:
        """Return all orders, followers that go along or wait, and ways round for one arm."""
        sides = [np.zeros(arms)]
        if arms <= 2:
            sides += [sign * np.eye(arms)[arm] for arm in range(arms) for sign in (1.0, -1.0)]
        orders = list(product((1.0, 0.0), repeat=arms - 1))
        rows = list(product((0.0, 1.0), (0.0, 1.0), orders, sides))
        if not self.skill.low:
            rows = [row for row in rows if row[0] == 0 and not np.any(row[3])]
        if arms == 1:
            rows = [row for row in rows if row[0] == row[1] == 0]
        shoves, waits, first, side = (np.array(part) for part in zip(*rows, strict=True))
        return Plan(first.reshape(len(rows), arms - 1), waits, shoves, side)

    def _cost(
        self, view: ArmView, plan: Plan, left: NDArray[np.intp], served: NDArray[np.bool_]
    ) -> FloatArray:
        """Simulate plans for ``left`` (n,) actions; return their costs (n,)."""
        n, arms = view.tool.shape[:2]
        contact = np.zeros(n)
        time = np.zeros((n, arms))
        done = self.skill.finished(view)
        for step in range(left.max()):
            goes_on = (step < left) & ~done.all(axis=-1)
            if not goes_on.any():
                break
            view = self.skill.imagine(view, self._act(view, plan, served), self.base)
            served = self._update(view, served)
            contact += goes_on * self._touching(view)
            time += goes_on[:, None] & ~done
            done = np.where(goes_on[:, None], self.skill.finished(view), done)
        fails = ~done.all(axis=-1)
        mean = time.mean(axis=-1)
        return self.FAILS * fails + self.CONTACT * contact + time.max(-1) + self.MEAN_TIME * mean

    def _touching(self, view: ArmView) -> FloatArray:
        """1 where two hands are too close, less where cubes are touched, (n,)."""
        hand, cube = view.tool[..., :2] + self.base, view.object[..., :2] + self.base
        touching = np.zeros(len(hand))
        ring = self.skill.ring(view.object_size) if self.skill.low else touching
        for right in range(hand.shape[1] - 1):
            gap = hand[:, right + 1] - hand[:, right]
            touching += gap[:, 1] < self._least(view, right, gap[:, 0]) - 0.01
            if not self.skill.low:
                continue
            for one, other in ((right, right + 1), (right + 1, right)):
                distance = length(hand[:, one] - cube[:, other])
                touching += self.BRUSH * (distance < ring[:, other] - 0.01)
        return touching

    def _act(self, view: ArmView, plan: Plan, done: NDArray[np.bool_]) -> FloatArray:
        """The skill's actions, changed where arms must give way."""
        hand, cube = view.tool[..., :2] + self.base, view.object[..., :2] + self.base
        arms = hand.shape[1]
        discs = np.concatenate([cube, view.object_size[..., None]], axis=-1)
        others = [np.roll(discs, -other, axis=1) for other in range(1, arms)]
        around = np.stack([*others, discs], axis=-2)
        around[..., :2] -= self.base[:, None]
        # Plans that shove take the other arms' cubes for far away.
        far = around[..., :-1, :] + 10.0 * plan.shoves[:, None, None, None] * (1, 1, 0)
        action = self.skill.actions(view, plan.side, far)
        move = action[..., :2] * self.skill.step
        move, turned = self._give_way(view, plan, hand, move, done)
        if self.skill.low:
            discs = around[..., :2] - view.tool[..., None, :2]
            radius = self.skill.ring(around[..., 2])
            size = length(move)
            beside = size[..., None] * way_round(move, discs, radius, 0 * size)
            move = np.where((turned | done)[..., None], beside, move)
        action[..., :2] = shortened(move, self.skill.step) / self.skill.step
        return self.skill.give_way(view, action, turned)

    def _give_way(
        self,
        view: ArmView,
        plan: Plan,
        hand: FloatArray,
        move: FloatArray,
        done: NDArray[np.bool_],
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Turn those that follow away from those that go first; return moves and who was turned."""
        move = move.copy()
        turned = np.zeros(done.shape, dtype=bool)
        # Least and greatest y (n, arms) of what each hand still has to pass, metres.
        y = hand[..., 1]
        ahead = (place[..., 1] + self.base[:, 1] for place in self.skill.places(view))
        corners = np.stack([y, *(np.where(done, y, place) for place in ahead)])
        low, high = corners.min(axis=0), corners.max(axis=0)
        for right in range(hand.shape[1] - 1):
            left = right + 1
            leads = np.where(
                done[:, left] == done[:, right], plan.first[:, right] > 0, done[:, left]
            )
            gap = hand[:, left] + move[:, left] - hand[:, right] - move[:, right]
            least = self._least(view, right, gap[:, 0])
            served = done[:, left] & done[:, right]
            deficit = least + np.where(served, 0.0, self.BUFFER) - gap[:, 1]
            waits = (plan.waits > 0) & ~done[:, left] & ~done[:, right]
            wide = self._least(view, right, np.zeros(1))
            late_left = high[:, right] + wide - hand[:, left, 1] - move[:, left, 1]
            late_right = hand[:, right, 1] + move[:, right, 1] - low[:, left] + wide
            back_left = np.where(waits, np.maximum(deficit, late_left), deficit)
            back_right = np.where(waits, np.maximum(deficit, late_right), deficit)
            yields_left, yields_right = leads & (back_left > 0), ~leads & (back_right > 0)
            move[:, left, 1] += np.where(yields_left, back_left, 0)
            move[:, right, 1] -= np.where(yields_right, back_right, 0)
            turned[:, left] |= yields_left
            turned[:, right] |= yields_right
            move = shortened(move, self.skill.step)
            # Hold one that goes first where the other has not got out of its way yet.
            gap = hand[:, left] + move[:, left] - hand[:, right] - move[:, right]
            lack = np.maximum(self._least(view, right, gap[:, 0]) - gap[:, 1], 0)
            move[:, right, 1] -= np.where(leads, lack, 0)
            move[:, left, 1] += np.where(leads, 0, lack)
            move = shortened(move, self.skill.step)
        return move, turned


def _rows(record: Record, index: NDArray[np.intp]) -> Record:
    """Return the records of episodes ``index``."""
    return replace(record, **{name: values[index] for name, values in vars(record).items()})


def alone_or_coordinated(
    task: Task,
    settings: Settings,
    skill: Skill,
    closed: Clearance,
    coordinated: bool,
    free_arm: int | None,
) -> Expert:
    """Build the expert of a task in which each arm has a cube of its own.

    :param task: the task.
    :param settings: give the look-ahead, which covers as much way at any speed.
    :param skill: what an arm does by itself.
    :param closed: how close two closed hands may come.
    :param coordinated: whether arms give way to one another.
    :param free_arm: the only arm that moves, or ``None``.
    """
    if free_arm is not None:
        return serves_all(task, skill, free_arm)
    if not coordinated or (task.n_arms == 1 and not skill.low):
        return Expert(task, skill.actions)
    base = base_poses(task.n_arms, "row")[0][:, :2]
    steps = round(task.horizon * DEFAULT_SPEED / settings.max_speed)
    if not skill.low:  # hands may carry slowly
        steps = max(steps, settings.horizon)
    coordinator = Coordinator(skill, base, closed, steps)
    return Expert(task, coordinator.actions, coordinator)
