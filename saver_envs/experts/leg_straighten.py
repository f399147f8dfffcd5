"""The leg straighten expert: pushes legs of a limp person side by side."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Self

import numpy as np
from numpy.typing import NDArray

from saver_envs.control import shortened
from saver_envs.episodes import Settings
from saver_envs.experts.expert import Expert
from saver_envs.experts.geometry import FloatArray
from saver_envs.experts.limbs import GAIN, mirrored, seen_points, way_over
from saver_envs.simulation import ACTION_DURATION
from saver_envs.tasks.contract import Task
from saver_envs.tasks.leg_straighten import LegStraighten
from saver_envs.tasks.leg_straighten_starts import ASIDE

Modes = NDArray[np.intp]
#: What a hand does: push the other leg away, push the leg at its side inwards, leave.
AWAY, INWARDS, LEAVE = range(3)


@dataclass(frozen=True)
class LegView:
    """What the arms see; leading dimensions (n, arms).

    Points are in the arms' base frames, those of arm 0 mirrored: x points to the person's head, y
    outwards, metres.

    :param tool: (n, arms, 3).
    :param ankle: (n, arms, 3).
    :param knee: (n, arms, 3).
    :param other_ankle: (n, arms, 3) of the leg at the other arm.
    :param other_knee: (n, arms, 3).
    :param target: (n, arms, 3) of the ankles.
    """

    tool: FloatArray
    ankle: FloatArray
    knee: FloatArray
    other_ankle: FloatArray
    other_knee: FloatArray
    target: FloatArray

    @classmethod
    def of(cls, task: Task, observation: dict[str, FloatArray]) -> Self:
        """Read a batched goal-conditioned observation."""
        joints = {
            "ankle": "object",
            "knee": "knee",
            "other_ankle": "other ankle",
            "other_knee": "other knee",
        }
        return cls(**seen_points(task, observation, joints))


@dataclass(frozen=True)
class LegSkill:
    """What each hand does with the legs; the hands have no need to coordinate.

    A hand only ever pushes towards the middle and beyond: the other leg away, from the inside,
    where that lies too far at this hand's side, and else the leg at its own side inwards.

    :param step: longest displacement of an action, metres.
    """

    step: float

    #: A leg is pushed whose ankle is farther than this from its target across the bed, until it is
    #: so near (m).
    FAR, NEAR = 0.035, 0.015
    #: Where a leg is pushed, a share of the shank from the ankle on.
    SHARE = 0.2
    #: How far beside the axis of a shank a hand comes down, and is at least behind it (m).
    BESIDE, AHEAD = 0.13, 0.02
    #: Heights of hands that push and that travel (m).
    LOW, TRAVEL = -0.045, 0.28
    #: Longest displacement of an action: coming down, pushing (m).
    DOWN, PACE = 0.012, 0.008

    def actions(self, view: LegView) -> FloatArray:
        """Return the arms' actions (n, arms, 3) in [-1, 1]."""
        mode = self._mode(view)
        away = (mode == AWAY)[..., None]
        ankle = np.where(away, view.other_ankle, view.ankle)
        knee = np.where(away, view.other_knee, view.knee)
        point = ankle + self.SHARE * (knee - ankle)
        point[..., 2] = self.LOW
        way = point - view.tool
        beside = -way[..., 1]
        behind = (beside > self.AHEAD) & (beside < self.BESIDE + 0.03)
        ready = behind & (np.abs(way[..., 0]) < 0.06) & (np.abs(way[..., 2]) < 0.03)
        push = way * np.array([0.2, 0.0, GAIN]) - np.array([0.0, self.PACE, 0.0])
        entry = way + np.array([0.0, self.BESIDE, 0.0])
        travel = way_over(view.tool, entry, self.TRAVEL, self.DOWN, self.step)
        rise = np.zeros_like(way)
        rise[..., 2] = GAIN * (self.TRAVEL - 0.04 - view.tool[..., 2])
        move = np.where(ready[..., None], push, travel)
        move = np.where((mode == LEAVE)[..., None], rise, move)
        return mirrored(shortened(move, self.step) / self.step)

    def _mode(self, view: LegView) -> Modes:
        """Choose what each hand does next."""
        target = view.target[..., 1]
        crossed = view.other_ankle[..., 1] - (target - 2 * ASIDE)
        outside = view.ankle[..., 1] - target
        low = view.tool[..., 2] < 0.05
        # A hand between the legs.
        between = low & (view.tool[..., 1] < view.ankle[..., 1])
        return np.select(
            [
                crossed > np.where(between, self.NEAR, self.FAR),
                outside > np.where(low, self.NEAR, self.FAR),
            ],
            [AWAY, INWARDS],
            LEAVE,
        )


def expert(
    task: LegStraighten, settings: Settings, coordinated: bool, free_arm: int | None
) -> Expert:
    """Build the expert of the task; see :func:`saver_envs.experts.make_expert`."""
    skill = LegSkill(settings.max_speed * ACTION_DURATION)
    read = partial(LegView.of, task)
    return Expert(task, skill.actions, read=read, free_arm=free_arm)
