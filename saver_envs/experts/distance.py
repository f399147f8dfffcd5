"""The distance expert: both hands grasp, close together, and carry their cubes like a bar."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from saver_envs.control import shortened
from saver_envs.episodes import Settings
from saver_envs.experts.blocks import ArmView
from saver_envs.experts.expert import Expert
from saver_envs.experts.frozen import serves_all
from saver_envs.experts.geometry import FloatArray, dot, length, unit
from saver_envs.experts.pick import PickSkill, skill_for
from saver_envs.scenes import base_poses
from saver_envs.tasks.distance import REQUIRED_DISTANCE, Distance


@dataclass(frozen=True)
class DistanceExpert:
    """Two arms whose cubes stay 0.35 m apart: the bar between them moves and turns as one.

    :param base: (2, 3) base positions, metres.
    :param skill: how a hand comes to its cube.
    :param pace: share of the top speed at which the cubes are carried; arms track slower motion
        better.
    """

    base: FloatArray
    skill: PickSkill = field(default_factory=PickSkill)
    pace: float = 0.7

    #: Cubes on the table are carried this far above it (m), and come down on the last way (1).
    LIFT, DESCENT = 0.03, 0.5
    #: Share of a length error that an action corrects.
    CORRECTION = 0.3

    def actions(self, view: ArmView) -> FloatArray:
        """Return the arms' actions (n, 2, 4) in [-1, 1]."""
        action = self.skill.actions(view)
        gap = self.skill.place(view) - view.tool
        ready = length(gap) < 1.5 * self.skill.AT_GRASP
        ready |= self.skill.is_closing(view)
        waits = ready & ~ready.all(axis=-1, keepdims=True)
        holds = np.logical_and.reduce(self.skill.holds(view), axis=-1)
        closes = (np.logical_and.reduce(ready, axis=-1) | holds)[:, None]
        still = shortened(gap, self.skill.step) / self.skill.step
        action[..., :3] = np.where((waits | closes)[..., None], still, action[..., :3])
        action[..., 3] = np.where(closes, -1.0, self.skill.opening(view))
        carried = self._carry(view) / self.skill.step
        action[..., :3] = np.where(holds[:, None, None], carried, action[..., :3])
        return action

    def _carry(self, view: ArmView) -> FloatArray:
        """Displacements (n, 2, 3) of both cubes, metres: one step of the bar to its goal."""
        now, goal = view.object + self.base, view.target + self.base
        left = length(goal - now).max(axis=-1)
        goal[..., 2] += np.minimum(self.LIFT, self.DESCENT * left)[:, None]
        left = np.maximum(length(goal - now).max(axis=-1), 1e-6)
        share = np.minimum(1.0, self.pace * self.skill.step / left)[:, None]
        middle, goal_middle = now.mean(axis=1), goal.mean(axis=1)
        bar = now[:, 1] - now[:, 0]
        direction = turned(unit(bar), unit(goal[:, 1] - goal[:, 0]), share)
        size = length(bar)[:, None]
        size = size + self.CORRECTION * (REQUIRED_DISTANCE - size)
        middle = middle + share * (goal_middle - middle)
        ends = np.stack([middle - size / 2 * direction, middle + size / 2 * direction], axis=1)
        return shortened(ends - now, self.skill.step)


def turned(start: FloatArray, end: FloatArray, share: FloatArray) -> FloatArray:
    """Unit vectors (n, 3) turned by ``share`` (n, 1) of the way from ``start`` to ``end``."""
    angle = np.arccos(np.clip(dot(start, end), -1.0, 1.0))[:, None]
    across = unit(end - dot(start, end)[:, None] * start)
    return np.cos(share * angle) * start + np.sin(share * angle) * across


def expert(task: Distance, settings: Settings, coordinated: bool, free_arm: int | None) -> Expert:
    """Build the expert of the distance task; see :func:`saver_envs.experts.make_expert`.

    :raises ValueError: without coordination: both arms carry as one.
    """
    skill = skill_for(task, settings)
    if free_arm is not None:
        return serves_all(task, skill, free_arm)
    if not coordinated:
        raise ValueError("the expert of the distance task carries with both arms as one")
    return Expert(task, DistanceExpert(base_poses(2, "row")[0], skill).actions)
