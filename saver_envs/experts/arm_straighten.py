"""The arm straighten expert: pushes and drags arms of a limp person, whatever way they lie."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from saver_envs.control import shortened
from saver_envs.episodes import Settings
from saver_envs.experts.expert import Expert
from saver_envs.experts.geometry import FloatArray, dot, length, unit
from saver_envs.simulation import ACTION_DURATION
from saver_envs.tasks.arm_straighten import ArmStraighten
from saver_envs.tasks.contract import PENDING, Task

Bools = NDArray[np.bool_]
#: What a hand does: push the forearm footwards over the trunk, pull the upper arm off it, push the
#: forearm inwards on the bed, push the elbow inwards, drag the wrist to its target, leave.
SWEEP, HOOK, PUSH, PRESS, DRAG, LEAVE = range(6)
#: Sign of the outward direction along y, arm by arm.
OUTWARDS: Final = np.array([-1.0, 1.0])


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
    """

    tool: FloatArray
    fingers: FloatArray
    wrist: FloatArray
    elbow: FloatArray
    shoulder: FloatArray
    bend: FloatArray
    target: FloatArray

    @classmethod
    def of(cls, task: Task, observation: dict[str, FloatArray]) -> Self:
        """Read a batched goal-conditioned observation."""
        layout, seen = task.observation_layout, observation["observation"]
        tool = layout.get(seen, "gripper position")
        if task.observe_pending_motion:
            tool = tool + layout.get(seen, PENDING.name)
        joints = {"wrist": "object", "elbow": "elbow", "shoulder": "shoulder"}
        points = {name: layout.get(seen, f"{part} position") for name, part in joints.items()}
        return cls(
            tool=mirrored(tool),
            fingers=layout.get(seen, "finger positions").mean(axis=-1),
            bend=layout.get(seen, "elbow bend")[..., 0],
            target=mirrored(task.goal_layout.get(observation["desired_goal"], "object position")),
            **{name: mirrored(values) for name, values in points.items()},
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

    mode: NDArray[np.intp]
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
    the forearm to the hip, and the elbow inwards, which straightens the arm; at last an open hand
    takes the forearm between its fingers and drags it.

    :param step: longest displacement of an action, metres.
    :param bed: height of the bed in the bases' frames, metres.
    """

    step: float
    bed: float

    #: A wrist this far above its target lies on the trunk; an arm is folded whose forearm points
    #: headwards from straight inwards by an angle of this sine, and is unfolded up to that (m).
    ON_TRUNK, FOLDED, UNFOLDED = 0.06, -0.26, 0.3
    #: A wrist farther out than this is pushed inwards, where the elbow is straight, and where it is
    #: to be pressed inwards, which moves the wrist as well; one that is nearer than that to its
    #: target is left (m).
    FAR, FAR_BENT, NEAR = 0.03, 0.06, 0.045
    #: Bend up to which an elbow counts as straight, also while it is pressed, since it springs back
    #: (rad).
    BENT, PRESSED_TO = np.radians(22.0), np.radians(17.0)
    #: Where limbs are pushed, shares of the forearm from the elbow on: far from an elbow that is
    #: straight, near one that is bent by so much (rad), which the push would bend further. The
    #: upper arm is pulled this share of it from the elbow.
    SWEPT, DRAGGED, HOOKED = 1.15, 0.72, 0.12
    PUSHED = (np.radians([12.0, 35.0]), [0.8, 0.15])
    #: A swept forearm is pushed this far above its axis, and limbs on the bed this far below that
    #: of a forearm; a dragged one is taken this far below it, but no lower than this (m).
    ABOVE, UNDER, BELOW, LOWEST = 0.01, 0.005, 0.012, 0.018
    #: Distance of a closed hand from the surface of a forearm and of an upper arm that it pushes,
    #: air for coming down beside it, and distance of the inner fingers of an open hand from its
    #: axis (m); thickness of an upper arm, in forearms.
    TOUCH, ELBOW, AIR, THICKER = 0.029, 0.022, 0.025, 1.75
    ASTRIDE, THICKEST, CLEAR = 1.7, 0.066, 0.052
    #: Height above an arm on the bed at which hands travel (m).
    TRAVEL = 0.34
    #: Share of the way left that an action covers.
    GAIN = 0.3
    #: Longest displacement of an action: coming down, closing in on a limb, pushing it, pressing an
    #: elbow, dragging (m).
    DOWN, CLOSING, PACE, GENTLE, ALONG = 0.008, 0.01, 0.006, 0.003, 0.004
    #: Greatest turn of an arm about its shoulder in an action (rad).
    TURN = 0.02
    #: Mean finger angle from which a hand has closed on a forearm, and up to which it has let go
    #: (rad).
    CLOSED, OPEN = 0.6, 0.35

    def actions(self, view: StraightenView) -> FloatArray:
        """Return the arms' actions (n, arms, 4) in [-1, 1]."""
        grip = self._grip(view)
        way = grip.entry - view.tool
        ahead, aside = grip.offset(view.tool)
        rod = self._is_rod(grip.mode)
        near = np.abs((view.tool - grip.point)[..., 2])
        off = length(aside)
        move = self._travel(view, way)
        pushes = rod & (near < 0.03) & self._behind(grip, ahead, off)
        move = np.where(pushes[..., None], self._push(view, grip), move)
        pulls = (grip.mode == HOOK) & (ahead < 0.10) & (ahead > -0.02) & (off < 0.03)
        pulls &= np.abs(way[..., 2]) < 0.025
        pull = self.PACE * grip.heading - 0.2 * aside
        move = np.where(pulls[..., None], self._level(pull, way), move)
        between = (length((view.tool - grip.point)[..., :2]) < 0.035) & (near < 0.035)
        holds = (grip.mode == DRAG) & between & (view.fingers > self.CLOSED)
        takes = (grip.mode == DRAG) & between & (np.abs(way[..., 2]) < 0.012) & ~holds
        move = np.where(takes[..., None], 0.2 * way, move)
        move = np.where(holds[..., None], self._level(self._carried(view), way), move)
        leaves = (grip.mode == LEAVE)[..., None]
        move = np.where(leaves, self._leave(view, off < 0.04), move)
        command = np.where(rod | holds | takes, -1.0, 1.0)
        motion = mirrored(shortened(move, self.step) / self.step)
        return np.concatenate([motion, command[..., None]], axis=-1)

    @staticmethod
    def _is_rod(mode: NDArray[np.intp]) -> Bools:
        """Return which hands push with closed fingers."""
        return (mode == SWEEP) | (mode == PUSH) | (mode == PRESS)

    def _grip(self, view: StraightenView) -> Grip:
        """Choose what each hand does next."""
        fore, upper = view.wrist - view.elbow, view.elbow - view.shoulder
        forward, along = unit(fore[..., :2]), unit(upper[..., :2])
        gap = view.wrist - view.target
        near = length(gap[..., :2]) < self.NEAR
        folded = forward[..., 0] < np.where(self._sweeps(view, fore), self.UNFOLDED, self.FOLDED)
        bent = view.bend > np.where(self._presses(view), self.PRESSED_TO, self.BENT)
        far = gap[..., 1] > np.where(bent, self.FAR_BENT, self.FAR)
        mode = np.select(
            [gap[..., 2] > self.ON_TRUNK, far, bent, near],
            [np.where(folded, SWEEP, HOOK), PUSH, PRESS, LEAVE],
            DRAG,
        )
        share = np.select(
            [mode == SWEEP, mode == PUSH, mode == PRESS],
            [self.SWEPT, np.interp(view.bend, *self.PUSHED), 0.0],
            self.DRAGGED,
        )
        hooks = (mode == HOOK)[..., None]
        limb = np.where(hooks, -self.HOOKED * upper, share[..., None] * fore)
        point = view.elbow + limb
        radius = view.target[..., 2] - self.bed
        thick = self.THICKER * radius
        on_bed = view.target[..., 2] - self.UNDER
        above = point[..., 2] + self.ABOVE
        point[..., 2] = np.select(
            [mode == SWEEP, (mode == PUSH) | (mode == PRESS), mode == HOOK],
            [above, on_bed, point[..., 2] + np.maximum(thick - self.CLEAR, 0.0)],
            point[..., 2],
        )
        heading = np.select(
            [(mode == SWEEP)[..., None], hooks, (mode == PRESS)[..., None]],
            [np.broadcast_to([1.0, 0.0], along.shape), _left(along), -_left(along)],
            -_left(forward),
        )
        touch = np.where(mode == PRESS, thick + self.ELBOW, radius + self.TOUCH)
        astride = self.ASTRIDE * np.maximum(self.THICKEST - thick, 0.0)
        back = np.select([self._is_rod(mode), mode == HOOK], [-touch - self.AIR, astride], 0.0)
        entry = point.copy()
        entry[..., :2] += back[..., None] * heading
        low = np.maximum(point[..., 2] - self.BELOW, view.target[..., 2] - self.LOWEST)
        entry[..., 2] = np.where(mode == DRAG, low, point[..., 2])
        return Grip(mode, point, heading, touch, entry)

    def _presses(self, view: StraightenView) -> Bools:
        """Return which hands are beside an elbow on the bed."""
        gap = view.tool - view.elbow
        beside = (np.abs(gap[..., 0]) < 0.08) & (gap[..., 1] > 0.02) & (gap[..., 1] < 0.12)
        return beside & (view.tool[..., 2] < view.target[..., 2] + 0.03)

    def _sweeps(self, view: StraightenView, fore: FloatArray) -> Bools:
        """Return which hands are headwards of a wrist on the trunk, close to it."""
        gap = view.tool - view.elbow - self.SWEPT * fore
        beside = (gap[..., 0] > -0.10) & (gap[..., 0] < 0.0) & (np.abs(gap[..., 1]) < 0.05)
        return beside & (np.abs(gap[..., 2]) < 0.05)

    def _behind(self, grip: Grip, ahead: FloatArray, off: FloatArray) -> Bools:
        """Return which hands are where they can push; a little aside if they touch already."""
        tolerance = np.where(ahead > -grip.touch - 0.012, 0.05, 0.02)
        return (ahead < -0.02) & (ahead > -0.14) & (off < tolerance)

    def _travel(self, view: StraightenView, way: FloatArray) -> FloatArray:
        """Return displacements (n, arms, 3): up, across, and down at the entry, metres."""
        height = view.target[..., 2] + self.TRAVEL
        aside = length(way[..., :2])
        down = np.clip(self.GAIN * way[..., 2], -self.DOWN, self.step)
        up = self.GAIN * (height - view.tool[..., 2])
        rise = np.select([aside < 0.02, aside < 0.05], [down, np.zeros_like(down)], up)
        crosses = (view.tool[..., 2] > height - 0.06) | (aside < 0.05)
        level = np.where(crosses[..., None], self.GAIN * way[..., :2], 0.0)
        return np.concatenate([level, rise[..., None]], axis=-1)

    def _push(self, view: StraightenView, grip: Grip) -> FloatArray:
        """Return displacements (n, arms, 3) of hands behind a limb, metres: gently at first."""
        ahead, aside = grip.offset(view.tool)
        left = -ahead - grip.touch - 0.005
        pace = np.where(grip.mode == PRESS, self.GENTLE, self.PACE)
        pace = np.where(left > 0, np.minimum(0.003 + 0.15 * left, self.CLOSING), pace)
        return self._level(pace[..., None] * grip.heading - 0.2 * aside, grip.point - view.tool)

    def _carried(self, view: StraightenView) -> FloatArray:
        """Return displacements (n, arms, 2) of wrists, about the shoulder to the target, metres."""
        here, there = ((one - view.shoulder)[..., :2] for one in (view.wrist, view.target))
        angle, goal = (np.arctan2(one[..., 1], one[..., 0]) for one in (here, there))
        angle = angle + np.clip(goal - angle, -self.TURN, self.TURN)
        far = length(here)
        far = far + np.clip(0.2 * (length(there) - far), -self.ALONG, self.ALONG)
        return far[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1) - here

    def _level(self, move: FloatArray, way: FloatArray) -> FloatArray:
        """Return displacements (n, arms, 3) with a share of the way left along the vertical."""
        return np.concatenate([move, self.GAIN * way[..., 2:]], axis=-1)

    def _leave(self, view: StraightenView, over: Bools) -> FloatArray:
        """Return displacements (n, arms, 3) upwards, metres, of hands that have let go."""
        height = view.target[..., 2] + self.TRAVEL - 0.05
        waits = over & (view.fingers > self.OPEN) & (view.tool[..., 2] < view.target[..., 2] + 0.1)
        rise = np.where(waits, 0.0, self.GAIN * (height - view.tool[..., 2]))
        return np.concatenate([np.zeros((*rise.shape, 2)), rise[..., None]], axis=-1)


def mirrored(points: FloatArray) -> FloatArray:
    """Return points or displacements (n, arms, 3) with y outwards, or back."""
    result = np.array(points)
    result[..., 1] *= OUTWARDS
    return result


def _left(direction: FloatArray) -> FloatArray:
    """Return directions (..., 2) turned to the left by a right angle."""
    return np.stack([-direction[..., 1], direction[..., 0]], axis=-1)


def expert(
    task: ArmStraighten, settings: Settings, coordinated: bool, free_arm: int | None
) -> Expert:
    """Build the expert of the task; see :func:`saver_envs.experts.make_expert`."""
    skill = StraightenSkill(settings.max_speed * ACTION_DURATION, task.bed.centre[2])

    def act(view: StraightenView) -> FloatArray:
        actions = skill.actions(view)
        if free_arm is not None:
            actions[:, np.arange(task.n_arms) != free_arm] = 0.0
        return actions

    return Expert(task, act, read=lambda seen: StraightenView.of(task, seen))
