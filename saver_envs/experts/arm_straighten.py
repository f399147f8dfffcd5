"""The arm straighten expert: pushes and pulls arms of a limp person straight."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Self

import numpy as np
from numpy.typing import NDArray

from saver_envs.control import shortened
from saver_envs.episodes import Settings
from saver_envs.experts.expert import Expert
from saver_envs.experts.geometry import FloatArray, dot, length, unit
from saver_envs.experts.limbs import GAIN, hand_force, mirrored, seen_points, way_over
from saver_envs.simulation import ACTION_DURATION
from saver_envs.tasks.arm_straighten import ArmStraighten
from saver_envs.tasks.contract import Task

Bools = NDArray[np.bool_]
Modes = NDArray[np.intp]
#: What a hand does: push the forearm footwards over the trunk, pull the upper arm off it, push the
#: forearm inwards on the bed, press the elbow inwards, pull the forearm outwards, leave.
SWEEP, HOOK, PUSH, PRESS, PULL, LEAVE = range(6)


@dataclass(frozen=True)
class StraightenView:
    """What the arms see; leading dimensions (n, arms).

    Points are in the arms' base frames, those of arm 0 mirrored: x points to the person's feet, y
    outwards, metres.

    :param tool: (n, arms, 3).
    :param fingers: (n, arms), their mean, radians.
    :param wrist: (n, arms, 3).
    :param elbow: (n, arms, 3).
    :param shoulder: (n, arms, 3).
    :param bend: (n, arms) of the elbows, radians.
    :param target: (n, arms, 3) of the wrists.
    :param force: (n, arms) that the hands press with, N.
    """

    tool: FloatArray
    fingers: FloatArray
    wrist: FloatArray
    elbow: FloatArray
    shoulder: FloatArray
    bend: FloatArray
    target: FloatArray
    force: FloatArray

    @classmethod
    def of(cls, task: Task, observation: dict[str, FloatArray]) -> Self:
        """Read a batched goal-conditioned observation."""
        layout, seen = task.observation_layout, observation["observation"]
        joints = {"wrist": "object", "elbow": "elbow", "shoulder": "shoulder"}
        return cls(
            fingers=layout.get(seen, "finger positions").mean(axis=-1),
            bend=layout.get(seen, "elbow bend")[..., 0],
            force=hand_force(task, observation),
            **seen_points(task, observation, joints),
        )


@dataclass(frozen=True)
class Grip:
    """Where and how each hand takes the person's arm; leading dimensions (n, arms).

    :param mode: what the hand does, one of :data:`SWEEP` to :data:`LEAVE`.
    :param point: (n, arms, 3) that is pushed, on the axis of the limb, metres.
    :param heading: (n, arms, 2) unit vectors in which it is pushed.
    :param touch: (n, arms) distance from the axis of the limb at which a closed hand touches it, m.
    :param entry: (n, arms, 3) where the hand comes down to the bed, metres.
    """

    mode: Modes
    point: FloatArray
    heading: FloatArray
    touch: FloatArray
    entry: FloatArray

    def offset(self, tool: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return how far hands are ahead of the points (n, arms), and aside (n, arms, 2), m."""
        relative = (tool - self.point)[..., :2]
        ahead = dot(relative, self.heading)
        return ahead, relative - ahead[..., None] * self.heading


@dataclass(frozen=True)
class StraightenSkill:
    """What each hand does with the arm at its side; the hands have no need to coordinate.

    An arm on the trunk is pulled off it by the upper arm, with the inner fingers of an open hand.
    A folded one, whose hand points to the head, is first unfolded. On the bed, a closed hand pushes
    the forearm to the hip, and the elbow inwards, which straightens the arm. Where that moves the
    wrist too far, the inner fingers of an open hand pull the forearm outwards again.

    :param step: longest displacement of an action, metres.
    :param bed: height of the bed in the bases' frames, metres.
    """

    step: float
    bed: float

    #: A wrist this far above its target lies on the trunk; an arm is folded whose forearm points
    #: headwards from straight inwards by an angle of this sine, and is unfolded up to that (m).
    ON_TRUNK, FOLDED, UNFOLDED = 0.06, -0.26, 0.3
    #: A wrist farther out than this is pushed inwards, where the elbow is straight, and where it is
    #: to be pressed inwards, which moves the wrist as well; one that is farther inside than this is
    #: pulled outwards until it is so near (m).
    FAR, FAR_BENT, INSIDE, NEAR = 0.03, 0.06, 0.045, 0.02
    #: Bend up to which an elbow counts as straight; how far inside a wrist is (m), and the bend up
    #: to which an elbow is pressed then (rad): it springs back, but the wrist moves inwards.
    BENT = np.radians(23.5)
    PRESSED_TO = ([-0.04, -0.02], np.radians([21.5, 17.0]))
    #: Where limbs are taken, shares of the forearm from the elbow on; the upper arm is pulled this
    #: share of it from the elbow.
    SWEPT, PULLED, HOOKED = 1.15, 0.4, 0.12
    #: Bends of the elbow (rad), and where the forearm is pushed: far from a straight elbow, nearer
    #: to a bent one, which the push would bend further.
    PUSHED = (np.radians([15.0, 45.0]), [0.8, 0.35])
    #: A swept hand is pushed this far below its axis, and limbs on the bed this far below that of a
    #: forearm (m).
    SUNK, UNDER = 0.015, 0.005
    #: Distance of a closed hand from the surface of a forearm and of an upper arm that it pushes,
    #: and air for coming down beside it (m); thickness of an upper arm, in forearms.
    TOUCH, ELBOW, AIR, THICKER = 0.029, 0.022, 0.025, 1.75
    #: The thickest limb that fits between the fingers of an open hand; it comes down farther
    #: outside over a thinner one, by so much a metre; over one thicker than this, higher (m).
    THICKEST, ASTRIDE, CLEAR = 0.066, 1.7, 0.052
    #: Height above an arm on the bed at which hands travel (m).
    TRAVEL = 0.34
    #: Longest displacement of an action: coming down, closing in on a limb, moving it, pressing an
    #: elbow (m).
    DOWN, CLOSING, PACE, GENTLE = 0.008, 0.01, 0.006, 0.0025
    #: Force that a hand keeps below (N), displacement per newton left, and when it yields (m).
    HARDEST, PER_NEWTON, YIELD = 110.0, 1e-4, 0.004
    #: Mean finger angle up to which a hand is open (rad).
    OPEN = 0.35

    def actions(self, view: StraightenView) -> FloatArray:
        """Return the arms' actions (n, arms, 4) in [-1, 1]."""
        grip = self._grip(view)
        way = grip.entry - view.tool
        ahead, aside = grip.offset(view.tool)
        off = length(aside)
        rod, astride = self._closed(grip.mode), self._open(grip.mode)
        height = view.target[..., 2] + self.TRAVEL
        move = way_over(view.tool, way, height, self.DOWN, self.step)
        tolerance = np.where(ahead > -grip.touch - 0.012, 0.10, 0.02)  # a hand slides along
        behind = (ahead < -0.02) & (ahead > -0.14) & (off < tolerance)
        pushes = rod & behind & (np.abs((view.tool - grip.point)[..., 2]) < 0.03)
        move = np.where(pushes[..., None], self._push(view, grip), move)
        over = (ahead < 0.10) & (ahead > -0.02) & (off < 0.03)
        pulls = astride & over & (np.abs(way[..., 2]) < 0.025)
        pace = np.minimum(self.PACE, self._allowed(view))
        pull = pace[..., None] * grip.heading - 0.2 * aside
        move = np.where(pulls[..., None], self._level(pull, way), move)
        rise = GAIN * (view.target[..., 2] + self.TRAVEL - 0.05 - view.tool[..., 2])
        leave = np.stack([np.zeros_like(rise), np.zeros_like(rise), rise], axis=-1)
        move = np.where((grip.mode == LEAVE)[..., None], leave, move)
        motion = mirrored(shortened(move, self.step) / self.step)
        return np.concatenate([motion, np.where(rod, -1.0, 1.0)[..., None]], axis=-1)

    @staticmethod
    def _closed(mode: Modes) -> Bools:
        """Return which hands push with closed fingers."""
        return (mode == SWEEP) | (mode == PUSH) | (mode == PRESS)

    @staticmethod
    def _open(mode: Modes) -> Bools:
        """Return which hands pull with open fingers."""
        return (mode == HOOK) | (mode == PULL)

    def _mode(self, view: StraightenView) -> Modes:
        """Choose what each hand does next."""
        fore, gap = view.wrist - view.elbow, view.wrist - view.target
        forward = unit(fore[..., :2])[..., 0]
        folded = forward < np.where(self._sweeps(view, fore), self.UNFOLDED, self.FOLDED)
        straight = np.interp(gap[..., 1], *self.PRESSED_TO)
        bent = view.bend > np.where(self._presses(view), straight, self.BENT)
        far = gap[..., 1] > np.where(bent, self.FAR_BENT, self.FAR)
        inside = gap[..., 1] < -np.where(self._pulls(view, fore), self.NEAR, self.INSIDE)
        return np.select(
            [gap[..., 2] > self.ON_TRUNK, far, bent, inside],
            [np.where(folded, SWEEP, HOOK), PUSH, PRESS, PULL],
            LEAVE,
        )

    def _grip(self, view: StraightenView) -> Grip:
        """Choose where each hand takes the arm, and how."""
        mode = self._mode(view)
        fore, upper = view.wrist - view.elbow, view.elbow - view.shoulder
        share = np.select(
            [mode == SWEEP, mode == PUSH, mode == PULL],
            [self.SWEPT, np.interp(view.bend, *self.PUSHED), self.PULLED],
            0.0,
        )
        hooks = (mode == HOOK)[..., None]
        point = view.elbow + np.where(hooks, -self.HOOKED * upper, share[..., None] * fore)
        radius = view.target[..., 2] - self.bed
        thick = self.THICKER * radius
        height, on_bed = point[..., 2], view.target[..., 2]
        point[..., 2] = np.select(
            [mode == SWEEP, mode == PUSH, mode == PRESS, mode == HOOK],
            [
                height - self.SUNK,
                np.minimum(height, on_bed) - self.UNDER,
                on_bed - self.UNDER,
                height + np.maximum(thick - self.CLEAR, 0.0),
            ],
            height,
        )
        outwards, across = _left(unit(upper[..., :2])), _left(unit(fore[..., :2]))
        kinds = [(mode == kind)[..., None] for kind in (SWEEP, HOOK, PRESS, PULL)]
        footwards = np.broadcast_to([1.0, 0.0], across.shape)
        heading = np.select(kinds, [footwards, outwards, -outwards, across], -across)
        touch = np.where(mode == PRESS, thick + self.ELBOW, radius + self.TOUCH)
        limb = np.where(mode == PULL, radius, thick)
        astride = self.ASTRIDE * np.clip(self.THICKEST - limb, 0.0, 0.02)
        back = np.select([self._closed(mode), self._open(mode)], [-touch - self.AIR, astride], 0.0)
        entry = point.copy()
        entry[..., :2] += back[..., None] * heading
        return Grip(mode, point, heading, touch, entry)

    def _sweeps(self, view: StraightenView, fore: FloatArray) -> Bools:
        """Return which hands are headwards of a hand on the trunk, close to it."""
        gap = view.tool - view.elbow - self.SWEPT * fore
        beside = (gap[..., 0] > -0.10) & (gap[..., 0] < 0.0) & (np.abs(gap[..., 1]) < 0.05)
        return beside & (np.abs(gap[..., 2]) < 0.05)

    def _presses(self, view: StraightenView) -> Bools:
        """Return which hands are beside an elbow on the bed."""
        gap = view.tool - view.elbow
        beside = (np.abs(gap[..., 0]) < 0.08) & (gap[..., 1] > 0.02) & (gap[..., 1] < 0.12)
        return beside & (view.tool[..., 2] < view.target[..., 2] + 0.03)

    def _pulls(self, view: StraightenView, fore: FloatArray) -> Bools:
        """Return which open hands are over a forearm on the bed."""
        low = view.tool[..., 2] < view.target[..., 2] + 0.03
        gap = view.tool - view.elbow - self.PULLED * fore
        return low & (length(gap[..., :2]) < 0.08) & (view.fingers < self.OPEN)

    def _push(self, view: StraightenView, grip: Grip) -> FloatArray:
        """Return displacements (n, arms, 3) of hands behind a limb, metres: gently at first."""
        ahead, aside = grip.offset(view.tool)
        left = -ahead - grip.touch - 0.005
        pace = np.where(grip.mode == PRESS, self.GENTLE, self.PACE)
        pace = np.where(left > 0, np.minimum(0.003 + 0.15 * left, self.CLOSING), pace)
        pace = np.minimum(pace, self._allowed(view))
        return self._level(pace[..., None] * grip.heading - 0.2 * aside, grip.point - view.tool)

    def _allowed(self, view: StraightenView) -> FloatArray:
        """Return how far hands may push (n, arms) for what they press with already, metres."""
        return np.maximum(self.PER_NEWTON * (self.HARDEST - view.force), -self.YIELD)

    def _level(self, move: FloatArray, way: FloatArray) -> FloatArray:
        """Return displacements (n, arms, 3) with a share of the way left along the vertical."""
        return np.concatenate([move, GAIN * way[..., 2:]], axis=-1)


def _left(direction: FloatArray) -> FloatArray:
    """Return directions (..., 2) turned to the left by a right angle."""
    return np.stack([-direction[..., 1], direction[..., 0]], axis=-1)


def expert(
    task: ArmStraighten, settings: Settings, coordinated: bool, free_arm: int | None
) -> Expert:
    """Build the expert of the task; see :func:`saver_envs.experts.make_expert`."""
    skill = StraightenSkill(settings.max_speed * ACTION_DURATION, task.bed.centre[2])
    read = partial(StraightenView.of, task)
    return Expert(task, skill.actions, read=read, free_arm=free_arm)
