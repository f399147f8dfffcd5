"""The leg straighten expert: frees tucked legs and pushes legs of a limp person side by side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Self

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

Bools = NDArray[np.bool_]
Modes = NDArray[np.intp]
#: What a hand does: push the leg at its side inwards, push the other leg away, leave.
OWN, OTHER, LEAVE = range(3)


@dataclass(frozen=True)
class LegView:
    tool: FloatArray
    ankle: FloatArray
    knee: FloatArray
    other_ankle: FloatArray
    other_knee: FloatArray
    bend: FloatArray
    target: FloatArray

    @classmethod
    def of(cls, task: Task, observation: dict[str, FloatArray]) -> Self:
        """Read a batched goal-conditioned observation."""
        layout, seen = task.observation_layout, observation["observation"]
        joints = {
            "ankle": "object",
            "knee": "knee",
            "other_ankle": "other ankle",
            "other_knee": "other knee",
        }
        bend = layout.get(seen, "knee bend")[..., 0]
        return cls(bend=bend, **seen_points(task, observation, joints))


@dataclass(frozen=True)
class LegSkill:
    step: float
    middle: float

    BENT = np.radians(15.0)
    FAR, NEAR = 0.03, 0.01
    SHARE = 0.25
    BESIDE = 0.13
    LOW = -0.045
    TRAVEL = 0.28
    DOWN, CLOSING, PACE = 0.012, 0.01, 0.006

    def actions(self, view: LegView) -> FloatArray:
        mode = self._mode(view)
        other = (mode == OTHER)[..., None]
        ankle = np.where(other, view.other_ankle, view.ankle)
        knee = np.where(other, view.other_knee, view.knee)
        point = ankle + self.SHARE * (knee - ankle)
        point[..., 2] = self.LOW
        entry = point.copy()
        entry[..., 1] += self.BESIDE
        ahead = view.tool[..., 1] - point[..., 1]  # 0 < outside of the shank
        along = view.tool[..., 0] - point[..., 0]
        behind = (ahead > 0.02) & (ahead < self.BESIDE + 0.03) & (np.abs(along) < 0.06)
        low = view.tool[..., 2] < self.LOW + 0.03
        pace = np.where(ahead > 0.09, self.CLOSING, self.PACE)
        push = np.stack([-0.2 * along, -pace, GAIN * (self.LOW - view.tool[..., 2])], axis=-1)
        move = np.where((behind & low)[..., None], push, way_over(view.tool, entry - view.tool, self.TRAVEL, self.DOWN, self.step))
        rise = GAIN * (self.TRAVEL - 0.04 - view.tool[..., 2])
        zero = np.zeros_like(rise)
        leave = np.stack([zero, zero, rise], axis=-1)
        move = np.where((mode == LEAVE)[..., None], leave, move)
        return mirrored(shortened(move, self.step) / self.step)

    def _mode(self, view: LegView) -> Modes:
        gap = view.ankle[..., 1] - view.target[..., 1]
        pushing = view.tool[..., 2] < 0.0
        far = gap > np.where(pushing, self.NEAR, self.FAR)
        # The other leg's target is the mirror image, about the middle.
        inside = (2 * self.middle - view.target[..., 1]) - view.other_ankle[..., 1]
        near = -inside
        off = (view.other_ankle[..., 1] - (2 * self.middle - view.target[..., 1])) > np.where(
            pushing, self.NEAR, self.FAR
        )
        return np.select([view.bend > self.BENT, far, off], [OTHER, OWN, OTHER], LEAVE)


def expert(
    task: LegStraighten, settings: Settings, coordinated: bool, free_arm: int | None
) -> Expert:
    """Build the expert of the task; see :func:`saver_envs.experts.make_expert`."""
    skill = LegSkill(settings.max_speed * ACTION_DURATION, -task.posts)

    def act(view: LegView) -> FloatArray:
        actions = skill.actions(view)
        if free_arm is not None:
            actions[:, np.arange(task.n_arms) != free_arm] = 0.0
        return actions

    return Expert(task, act, read=lambda seen: LegView.of(task, seen))
