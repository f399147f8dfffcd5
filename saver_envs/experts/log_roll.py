"""The log-roll expert: both bars go under the flank and turn thorax and pelvis in step."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Self

import numpy as np
from numpy.typing import NDArray

from saver_envs.episodes import Settings
from saver_envs.experts.expert import Expert
from saver_envs.experts.geometry import FloatArray, dot, length
from saver_envs.robots.ur10e import BAR_RADIUS
from saver_envs.simulation import ACTION_DURATION
from saver_envs.tasks.contract import PENDING, Task
from saver_envs.tasks.log_roll import LogRoll

Bools = NDArray[np.bool_]
#: Across the person: depth and height.
_ACROSS = [0, 2]


@dataclass(frozen=True)
class RollView:
    """What the arms see, each in its own base frame; leading dimensions (n, arms).

    :param tool: (n, arms, 3) middles of the bars, metres.
    :param flank: (n, arms, 3) middles of the flanks, metres.
    :param radius: (n, arms) of the flanks, metres.
    :param force: (n, arms) that the hands press with, N.
    :param turn: (n, arms) of thorax and pelvis, rad.
    :param wanted: (n, arms), rad.
    """

    tool: FloatArray
    flank: FloatArray
    radius: FloatArray
    force: FloatArray
    turn: FloatArray
    wanted: FloatArray

    @classmethod
    def of(cls, task: Task, observation: dict[str, FloatArray]) -> Self:
        """Read a batched goal-conditioned observation."""
        layout, seen = task.observation_layout, observation["observation"]
        tool, press = layout.get(seen, "gripper position"), layout.part("gripper force")
        if task.observe_pending_motion:
            tool = tool + layout.get(seen, PENDING.name)
        return cls(
            tool=tool,
            flank=layout.get(seen, "object position"),
            radius=layout.get(seen, "object radius")[..., 0],
            force=length(layout.get(seen, press.name)) / press.scale,
            turn=observation["achieved_goal"],
            wanted=observation["desired_goal"],
        )


@dataclass(frozen=True)
class RollSkill:
    """What the hands do, together or each by itself.

    A bar that is moved round the line on which the person rolls, mostly upwards, carries the flank
    along by friction; one that is pushed ahead slides the person over the bed.

    :param step: longest displacement of an action, metres.
    :param bed: height of the bed, metres.
    :param together: neither part of the trunk gets ahead of the other.
    """

    step: float
    bed: float
    together: bool = True

    #: Height of a bar over the bed (m), and where it presses, along the body from the middle of
    #: the flank, arm by arm (m): below the shoulder blade, and above the thigh.
    CLEAR, ALONG = 0.009, (-0.02, -0.085)
    #: How far before the flank a bar comes down (m); share of the way left that an action covers.
    BEFORE, GAIN = 0.04, 0.3
    #: Steps of an action: towards the flank at least, before it, along the body (m).
    LEAST, FAST, ASIDE = 0.0015, 0.012, 0.01
    #: A hand that presses harder (N) has contact.
    CONTACT = 3.0
    #: How much less than wanted is turned (rad): well within the tolerance, and gentler.
    SHORT = math.radians(7.0)
    #: How far ahead of the other part one is turned, the turn of an action, and the share of the
    #: turn left that it covers (rad).
    AHEAD, RATE, SHARE = 0.05, 0.008, 0.1
    #: Distance of the line on which the person rolls from the flank, in radii, arm by arm.
    WIDE = (1.5, 1.0)
    #: Force that a hand keeps below, arm by arm (N), and turn of an action per newton left; it
    #: yields by no more than this (rad).
    HARDEST, PER_NEWTON, YIELD = (190.0, 170.0), 1e-4, 0.004
    #: How far a bar may have slipped up round the flank (rad); one that has moves up by no more
    #: than this share of what it moves inwards: friction then carries the flank along.
    SLIP, CONE = 0.25, 0.30

    def actions(self, view: RollView) -> FloatArray:
        """Return the arms' actions (n, arms, 3) in [-1, 1]."""
        gap = view.flank - view.tool
        across = gap[..., _ACROSS]
        reach = view.radius + BAR_RADIUS
        far = length(across)
        inwards = across / far[..., None]
        touches = view.force > self.CONTACT
        pace = np.clip(self.GAIN * (far - reach), self.LEAST, self.FAST)
        turned = view.turn > self.AHEAD
        approach = np.where(turned[..., None], inwards, [1.0, 0.0]) * pace[..., None]
        height = self.bed + BAR_RADIUS + self.CLEAR - view.tool[..., 2]
        approach[..., 1] += np.where(turned, 0.0, self.GAIN * height)
        rolling = self._roll(view, inwards, reach)
        move = np.where(touches[..., None], rolling, approach)
        above = ~touches & ~turned & (height < -self.CLEAR)
        move = np.where(above[..., None], self._down(across, reach, height), move)
        aside = np.clip(self.GAIN * (gap[..., 1] + self.ALONG), -self.ASIDE, self.ASIDE)
        aside = np.where(touches, 0.0, aside)
        return np.stack([move[..., 0], aside, move[..., 1]], axis=-1) / self.step

    def _down(self, across: FloatArray, reach: FloatArray, height: FloatArray) -> FloatArray:
        """Displacements (n, arms, 2): down to the bed, not nearer to the flank than at first."""
        back = np.minimum(across[..., 0] - reach - self.BEFORE, 0.0)
        move = self.GAIN * np.stack([back, height], axis=-1)
        return np.clip(move, -self.ASIDE, self.ASIDE)

    def _roll(self, view: RollView, inwards: FloatArray, reach: FloatArray) -> FloatArray:
        """Displacements (n, arms, 2) of bars in contact: round the line on which people roll."""
        axis = view.flank[..., 0] + self.WIDE * view.radius * np.cos(np.maximum(view.turn, 0.0))
        lever = np.stack([view.tool[..., 2] - self.bed, axis - view.tool[..., 0]], axis=-1)
        move = self._turn(view)[..., None] * lever
        upwards = np.stack([-inwards[..., 1], inwards[..., 0]], axis=-1)
        low = (view.radius - BAR_RADIUS - self.CLEAR) / reach
        carried = np.arcsin(low) - np.maximum(view.turn, 0.0)
        slips = np.arctan2(inwards[..., 1], inwards[..., 0]) < carried - self.SLIP
        push, climb = dot(move, inwards), dot(move, upwards)
        climb = np.where(slips, np.minimum(climb, self.CONE * push), climb)
        return push[..., None] * inwards + climb[..., None] * upwards

    def _turn(self, view: RollView) -> FloatArray:
        """Turns (n, arms) of an action, rad: in step, and not harder than allowed."""
        slowest = view.turn.min(axis=1, keepdims=True) if self.together else view.turn
        wanted = np.minimum(view.wanted - self.SHORT, slowest + self.AHEAD)
        turn = np.clip(self.SHARE * (wanted - view.turn), -self.RATE, self.RATE)
        room = self.PER_NEWTON * (np.array(self.HARDEST) - view.force)
        return np.minimum(turn, np.maximum(room, -self.YIELD))


def expert(task: LogRoll, settings: Settings, coordinated: bool, free_arm: int | None) -> Expert:
    """Build the expert of the log roll; see :func:`saver_envs.experts.make_expert`.

    A free arm turns its part of the trunk as if the other did the same.
    """
    together = coordinated and free_arm is None
    skill = RollSkill(settings.max_speed * ACTION_DURATION, task.bed.centre[2], together)
    read = partial(RollView.of, task)
    return Expert(task, skill.actions, read=read, free_arm=free_arm)
