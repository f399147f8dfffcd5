"""The pick-and-place skill: come from above, close the hand, carry the cube to its target."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from saver_envs.control import length, shortened
from saver_envs.episodes import Settings
from saver_envs.experts.blocks import ArmView
from saver_envs.experts.coordination import JACO_HOLDING, alone_or_coordinated
from saver_envs.experts.expert import Expert
from saver_envs.experts.geometry import FloatArray
from saver_envs.experts.push import TRACKING
from saver_envs.experts.skill import Skill
from saver_envs.simulation import ACTION_DURATION
from saver_envs.tasks.pick_and_place import CarryTask, PickAndPlace


@dataclass(frozen=True)
class PickSkill(Skill):
    """What each arm does on its own, and a rough prediction of the result.

    :param grasp_offset: the tool grasps where this is its offset from the cube's centre, metres.
    :param finger_open: mean finger angle of an open hand, radians.
    :param finger_held: that at which the fingers stop on a cube of the usual size, radians.
    :param half_open: gripper command for coming down over a cube: wide enough for it, and
        narrower than an open hand, which would meet its neighbours.
    :param cruise: height at which cubes are carried, and hands travel above them, metres.
    :param usual: edge of the cubes that these values fit, metres; others change them.
    :param gentle: share of the usual speed at which cubes of other sizes are carried.
    """

    grasp_offset: tuple[float, float, float] = (0.0, 0.0, -0.004)
    finger_open: float = 0.20
    finger_held: float = 0.85
    half_open: float = 0.30
    cruise: float = 0.11
    usual: float = 0.056
    gentle: float = 0.4

    own_last: ClassVar[bool] = True
    #: Share of the way left that an action covers: with more, hands overshoot where actions or
    #: observations are delayed.
    GAIN = 0.3
    #: A hand comes down where it is this near to being above its cube (m), and closes where it is
    #: this near to its place of grasp.
    ABOVE, AT_GRASP = 0.03, 0.015
    #: A cube this far from the tool's place of grasp may still be between the fingers (m).
    WITHIN = 0.055
    #: A hand that moves slower than this (m/s) has come to rest: it closes around a cube that is
    #: near enough, and comes down to one that it cannot get nearer to.
    STILL = 0.025
    #: A carried cube comes down to its target where it is this near, horizontally (m).
    NEAR_TARGET = 0.06
    #: A cube this near its target is there (m).
    DONE = 0.03
    #: Fingers stop at a larger cube by this much earlier (rad/m), at a smaller one later.
    EARLIER, LATER = 15.0, 10.0
    #: Fingers that turn slower than this (rad/s) have stopped on what is between them, if they are
    #: closed by so much more than the hand was open (rad).
    STOPPED, BEGUN = 0.6, 0.08
    #: Actions in which a task can be done at full speed. In longer episodes cubes that may be large
    #: and heavy, and slip, are carried slowly.
    HURRIED = 50
    #: Least full speed, as a share of the usual one.
    SLOWEST = 0.4
    #: Averaged speed that hands reach in short moves, as a share of that of an action.
    REACHED = 0.58
    #: Sizes of unusual cubes are inferred, with errors of up to this (m).
    UNSURE = 0.02
    #: Extra height of hands, and of carried cubes, where sizes are inferred (m): lower fingers may
    #: touch the table. Greatest extra height of a grasp (m): higher hands miss the cube.
    SPARE, HIGHEST = 0.006, 0.014
    #: Finger angle of a unit of gripper command (rad).
    FINGER_COMMAND = 0.55
    #: Height above a cube's top at which a hand comes over it (m).
    OVER = 0.052
    #: Share of a larger size by which hands travel higher, so that a cube is carried over others.
    STACKED = 1.5
    #: Change of the finger angles in one action (rad).
    FINGER_RATE = 0.13

    def fitted(self, settings: Settings) -> Self:
        """Return the skill of an arm with these settings."""
        gentle = min(1.0, self.HURRIED / settings.horizon)
        return replace(super().fitted(settings), gentle=gentle)

    def finished(self, view: ArmView) -> NDArray[np.bool_]:
        """Return which cubes (n, arms) are where they are meant to be."""
        return length(view.target - view.object) < self.DONE

    def keeps(self, view: ArmView) -> NDArray[np.bool_]:
        """Return which hands (n, arms) have their cube between closed fingers."""
        return self.is_closing(view)

    def between_fingers(self, view: ArmView) -> NDArray[np.bool_]:
        """Return which cubes (n, arms) are near enough to be grasped or held."""
        return length(self.place(view) - view.tool) < self.WITHIN

    def _is_still(self, view: ArmView) -> NDArray[np.bool_]:
        still: NDArray[np.bool_] = length(view.tool_velocity) < self.STILL
        return still

    def holds(self, view: ArmView) -> NDArray[np.bool_]:
        """Return which hands (n, arms) hold their cube."""
        stopped = np.abs(view.finger_velocity.mean(axis=-1)) < self.STOPPED
        return stopped & self.is_closing(view)

    def is_closing(self, view: ArmView) -> NDArray[np.bool_]:
        """Return which hands (n, arms) have begun to close on their cube."""
        begun: NDArray[np.bool_] = view.fingers.max(axis=-1) > self._open(view) + self.BEGUN
        return begun & self.between_fingers(view)

    def _open(self, view: ArmView) -> FloatArray:
        """Finger angles (n, arms) of hands that come down over their cubes, radians."""
        return self.finger_open + self.FINGER_COMMAND * (1 - self.opening(view))

    def opening(self, view: ArmView) -> FloatArray:
        """Return the gripper commands (n, arms) for coming down over the cubes."""
        larger = np.maximum(view.object_size + self.UNSURE - self.usual, 0.0)
        wider = np.where(view.object_size == self.usual, 0.0, self.EARLIER * larger)
        return np.minimum(self.half_open + wider / self.FINGER_COMMAND, 1.0)

    def _earlier(self, view: ArmView) -> FloatArray:
        """By how much less fingers close on these cubes than on usual ones, (n, arms), rad."""
        larger = view.object_size - self.usual
        return np.where(larger > 0, self.EARLIER, self.LATER) * larger

    def _cruise(self, view: ArmView) -> FloatArray:
        """Height of travelling hands and cubes, over the largest of an episode, (n, 1), metres."""
        larger = view.object_size.max(axis=-1, keepdims=True) - self.usual
        return self.cruise + self.STACKED * np.maximum(larger, 0.0)

    def place(self, view: ArmView) -> FloatArray:
        """Return where the tools (n, arms, 3) grasp, metres."""
        place = view.object + np.asarray(self.grasp_offset, dtype=view.object.dtype)
        # Higher at small cubes, since the closing fingers go down.
        higher = np.maximum(self.usual - view.object_size, 0.0) / 2
        place[..., 2] += np.minimum(higher + self._spare(view), self.HIGHEST)
        return place

    def _spare(self, view: ArmView) -> FloatArray:
        """Return the extra height (n, arms) of hands at cubes whose size is inferred, metres."""
        return np.where(view.object_size == self.usual, 0.0, self.SPARE)

    def actions(
        self, view: ArmView, side: FloatArray | None = None, others: FloatArray | None = None
    ) -> FloatArray:
        """Return actions (n, arms, 4) in [-1, 1] of arms that ignore one another.

        :param view: what the arms see.
        :param side: not used: hands come from above.
        :param others: not used.
        """
        place = self.place(view)
        gap = place - view.tool
        holds = self.holds(view)
        stuck = self._is_still(view) & self.between_fingers(view)
        closes = self.is_closing(view) | (length(gap) < self.AT_GRASP) | stuck
        move = np.where(holds[..., None], self._carry(view), self._approach(view, gap))
        move = np.where((closes & ~holds)[..., None], gap, move)
        grip = np.where(closes | holds, -1.0, self.opening(view))
        gentle = np.minimum(self.gentle / self._pace(view), 1.0)
        share = np.where(holds & (view.object_size != self.usual), gentle, 1.0)
        move = shortened(self.GAIN * move, self.step * share[..., None]) / self.step
        return np.concatenate([move, grip[..., None]], axis=-1)

    def _pace(self, view: ArmView) -> FloatArray:
        """Return the full speed (n, arms) as a share of the usual one, 1 until it is known."""
        pace = view.top_speed * ACTION_DURATION / (self.REACHED * self.step)
        return np.where(view.top_speed > 0, np.clip(pace, self.SLOWEST, 1.0), 1.0)

    def _approach(self, view: ArmView, gap: FloatArray) -> FloatArray:
        """Displacement to above the cube, then down to it."""
        aside = length(gap[..., :2])
        over = view.object[..., 2] + view.object_size / 2 + self.OVER
        above = np.maximum(self._cruise(view), over) - view.tool[..., 2]
        near = (aside < self.ABOVE) | (self._is_still(view) & (aside < 2 * self.ABOVE))
        rise = np.where(near, gap[..., 2], above)
        # Near the base not every hand gets as high as it would travel.
        low = (aside >= self.ABOVE) & (aside < 0.12) & (over - view.tool[..., 2] > 0.03)
        across = np.where(low[..., None], 0.0, gap[..., :2])
        return np.concatenate([across, rise[..., None]], axis=-1)

    def _carry(self, view: ArmView) -> FloatArray:
        """Displacement of a held cube over others' heads to its target."""
        left = view.target - view.object
        left[..., 2] += self._spare(view)
        away = length(left[..., :2]) > self.NEAR_TARGET
        cruise = np.maximum(self._cruise(view), view.target[..., 2]) - view.object[..., 2]
        rise = np.where(away, np.clip(cruise, 0, None), left[..., 2])
        return np.concatenate([left[..., :2], rise[..., None]], axis=-1)

    def give_way(self, view: ArmView, action: FloatArray, turned: NDArray[np.bool_]) -> FloatArray:
        """Return actions of which those of hands that are ``turned`` away first leave the cube.

        :param view: what the arms see.
        :param action: (n, arms, 4).
        :param turned: (n, arms).
        """
        leaves = turned & ~self.is_closing(view)
        over = leaves & (length(view.tool - view.object) < 0.06)
        action = action.copy()
        action[..., :2] = np.where(over[..., None], 0.0, action[..., :2])
        rises = np.where(view.tool[..., 2] < self._cruise(view), 1.0, 0.0)
        action[..., 2] = np.where(leaves, rises, action[..., 2])
        action[..., 3] = np.where(leaves, self.opening(view), action[..., 3])
        return action

    def imagine(self, view: ArmView, actions: FloatArray, base: FloatArray) -> ArmView:
        """Predict what the arms see after ``actions``, roughly.

        :param view: what they see now.
        :param actions: (n, arms, 4).
        :param base: not used.
        """
        step = self.step * self._pace(view)[..., None]
        moved = TRACKING * step * shortened(actions[..., :3], 1.0)
        closing = np.where(actions[..., 3:] < 0, self.FINGER_RATE, -self.FINGER_RATE)
        most = (self.finger_held - self._earlier(view))[..., None]
        least = np.minimum(self._open(view)[..., None], most)
        fingers = np.clip(view.fingers + closing, least, most)
        velocity = (fingers - view.fingers) / ACTION_DURATION
        carried = self.holds(view)[..., None]
        return replace(
            view,
            tool=view.tool + moved,
            tool_velocity=moved / ACTION_DURATION,
            fingers=fingers,
            finger_velocity=velocity,
            object=view.object + np.where(carried, moved, 0),
            object_velocity=0 * view.object_velocity,
        )


#: What differs between robots' hands: the MICO's two fingers close further.
SKILLS = {"mico": PickSkill(finger_held=0.80, half_open=0.40)}


def skill_for(task: CarryTask, settings: Settings) -> PickSkill:
    """Return the skill of an arm with this task and these settings."""
    return SKILLS.get(settings.robot.name, PickSkill()).fitted(settings)


def expert(
    task: PickAndPlace, settings: Settings, coordinated: bool, free_arm: int | None
) -> Expert:
    """Build the expert of pick and place; see :func:`saver_envs.experts.make_expert`."""
    skill = skill_for(task, settings)
    return alone_or_coordinated(task, settings, skill, JACO_HOLDING, coordinated, free_arm)
