"""The carry expert: both hands take their grips, close together, and carry the board level."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Self

import numpy as np
from numpy.typing import NDArray

from saver_envs.control import shortened
from saver_envs.episodes import Settings
from saver_envs.experts.expert import Expert
from saver_envs.experts.geometry import FloatArray, length
from saver_envs.simulation import ACTION_DURATION
from saver_envs.tasks.carry import Carry
from saver_envs.tasks.contract import PENDING, Task

Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class CarryView:
    """What the arms see, each in its own base frame; leading dimensions (n, arms).

    :param tool: (n, arms, 3), metres.
    :param fingers: (n, arms), their mean, radians.
    :param finger_speed: (n, arms), the mean of their velocities without its sign, rad/s.
    :param end: (n, arms, 3) of the board, metres.
    :param target: (n, arms, 3), metres.
    """

    tool: FloatArray
    fingers: FloatArray
    finger_speed: FloatArray
    end: FloatArray
    target: FloatArray

    @classmethod
    def of(cls, task: Task, observation: dict[str, FloatArray]) -> Self:
        """Read a batched goal-conditioned observation; parts that arms share are not needed."""
        layout, seen = task.observation_layout, observation["observation"]
        speed = layout.part("finger velocities")
        tool = layout.get(seen, "gripper position")
        end = layout.get(seen, "object position")
        fingers = layout.get(seen, "finger positions").mean(axis=-1)
        if task.observe_pending_motion:
            # Where the hands, and what they hold, will be when what is decided now takes effect.
            pending = layout.get(seen, PENDING.name)
            held = (fingers > CarrySkill.CLOSED) & (length(end - tool) < CarrySkill.WITHIN)
            tool, end = tool + pending, np.where(held[..., None], end + pending, end)
        return cls(
            tool=tool,
            fingers=fingers,
            finger_speed=np.abs(layout.get(seen, speed.name).mean(axis=-1)) / speed.scale,
            end=end,
            target=task.goal_layout.get(observation["desired_goal"], "object position"),
        )


@dataclass(frozen=True)
class CarrySkill:
    """What the hands do, together or each by itself.

    :param step: longest displacement of an action, metres.
    :param together: hands close when both are ready, and keep the board level; else each lifts its
        own end.
    """

    step: float
    together: bool = True

    #: Share of the way left that an action covers.
    GAIN = 0.3
    #: A hand comes down where it is this near to being above its grip, from this far above it (m).
    ABOVE, OVER = 0.03, 0.11
    #: Gripper command for coming down over a grip.
    HALF_OPEN = 0.3
    #: A hand closes where it is this near its place at the grip (m), and while the grip is within
    #: that.
    AT_GRIP, WITHIN = 0.015, 0.05
    #: Mean finger angle from which a hand is closing, and from which it may hold (rad); fingers
    #: slower than this have stopped on the grip (rad/s).
    CLOSING, CLOSED, STOPPED = 0.70, 0.95, 0.6
    #: Share of the top speed at which the board is carried, and of a difference of the ends'
    #: heights that an action corrects.
    PACE, LEVELLING = 0.5, 0.15
    #: Share of a grip's distance from the middle of its hand, horizontally, that an action
    #: corrects: fingers yield, and hands that come nearer to one another squeeze the board out.
    CENTRING = 0.15

    def actions(self, view: CarryView) -> FloatArray:
        """Return the arms' actions (n, arms, 4) in [-1, 1]."""
        gap = view.end - view.tool
        near = length(gap) < self.WITHIN
        closing = near & (view.fingers > self.CLOSING)
        closes = self._all(closing | (length(gap) < self.AT_GRIP))
        stopped = view.finger_speed < self.STOPPED
        holds = self._all(near & stopped & (view.fingers > self.CLOSED))
        aside = length(gap[..., :2])
        rise = np.where(aside < self.ABOVE, gap[..., 2], gap[..., 2] + self.OVER)
        approach = np.concatenate([gap[..., :2], rise[..., None]], axis=-1)
        move = self.GAIN * np.where(closes[..., None], gap, approach)
        move = np.where(holds[..., None], self._carry(view), move)
        grip = np.where(closes, -1.0, self.HALF_OPEN)
        return np.concatenate([shortened(move, self.step) / self.step, grip[..., None]], axis=-1)

    def _carry(self, view: CarryView) -> FloatArray:
        """Displacements (n, arms, 3), metres: a step of both ends straight to their targets."""
        left = view.target - view.end
        far = length(left)
        if self.together:  # so that both arrive at the same time
            far = far.max(axis=1, keepdims=True)
        share = np.minimum(self.GAIN, self.PACE * self.step / np.maximum(far, 1e-6))
        move = left * share[..., None]
        if self.together:
            height = view.end[..., 2]
            move[..., 2] += self.LEVELLING * (height.mean(axis=1, keepdims=True) - height)
            move[..., :2] += self.CENTRING * (view.end - view.tool)[..., :2]
        return move

    def _all(self, ready: Bools) -> Bools:
        """Return which hands (n, arms) go on: those that are ready, or both at once."""
        if not self.together:
            return ready
        return np.broadcast_to(ready.all(axis=1, keepdims=True), ready.shape)


def expert(task: Carry, settings: Settings, coordinated: bool, free_arm: int | None) -> Expert:
    """Build the expert of the carry task; see :func:`saver_envs.experts.make_expert`.

    A free arm takes its grip and carries its end as if the other did the same.
    """
    skill = CarrySkill(settings.max_speed * ACTION_DURATION, coordinated and free_arm is None)
    read = partial(CarryView.of, task)
    return Expert(task, skill.actions, read=read, free_arm=free_arm)
