"""The intake expert: each hand sweeps the arm at its side inwards before it reaches the rail."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from saver_envs.control import shortened
from saver_envs.episodes import Settings
from saver_envs.experts.expert import Expert
from saver_envs.experts.geometry import FloatArray, unit
from saver_envs.experts.limbs import hand_force
from saver_envs.scenes import BASE_SPACING
from saver_envs.simulation import ACTION_DURATION
from saver_envs.tasks.contract import PENDING, Task
from saver_envs.tasks.intake import Intake
from saver_envs.tasks.limbs import LIMB_JOINTS, POSITIONS

Bools = NDArray[np.bool_]
#: Outwards along y, arm by arm.
_OUTWARDS: Final = np.array([-1.0, 1.0])
_WRIST, _ELBOW = LIMB_JOINTS.index("wrist"), LIMB_JOINTS.index("elbow")


@dataclass(frozen=True)
class IntakeView:
    """What the arms see; x forwards from the bases, then outwards from the midline, then up.

    :param tool: (n, arms, 3), metres.
    :param joints: (n, arms, joints, 3) of limbs, metres.
    :param force: (n, arms) that the hands press with, N.
    """

    tool: FloatArray
    joints: FloatArray
    force: FloatArray

    @classmethod
    def of(cls, task: Task, observation: dict[str, FloatArray]) -> Self:
        """Read a batched goal-conditioned observation."""
        layout, seen = task.observation_layout, observation["observation"]
        joints = np.stack([layout.get(seen, part.name) for part in POSITIONS], axis=2)
        tool = layout.get(seen, "gripper position")
        if task.observe_pending_motion:
            tool = tool + layout.get(seen, PENDING.name)
        return cls(
            tool=_outwards(tool, _OUTWARDS),
            joints=_outwards(joints, _OUTWARDS[:, None]),
            force=hand_force(task, observation),
        )


def _outwards(points: FloatArray, sign: FloatArray) -> FloatArray:
    """Return points with y counted from the midline, outwards."""
    result = points.copy()
    result[..., 1] = BASE_SPACING / 2 + sign * points[..., 1]
    return result


@dataclass(frozen=True)
class IntakeSkill:
    """What each arm does with the limbs at its side; the arms have no need to coordinate.

    A hand waits low outside of the fingers, as far ahead as it reaches, and sweeps the forearm in
    as soon as the fingers have passed it.

    :param step: longest displacement of an action, metres.
    """

    step: float

    #: A wrist and an elbow that are further out (m) are pushed.
    LIMITS = (0.25, 0.30)
    #: From where to where along x a hand attends to them (m).
    NEAREST, FARTHEST = 0.20, 0.90
    #: How far a hand reaches from its base, and between where along x it waits (m).
    REACH, LEAST, MOST = 0.535, 0.27, 0.50
    #: From a wrist to the fingertips; how far outside of these hands wait, and how exactly (m).
    HAND, CLEAR, ARRIVED = 0.18, 0.08, 0.03
    #: A hand pushes from where it is this far before the joint along x to where it is behind (m).
    BEFORE, BEHIND = 0.12, 0.10
    #: Height of the hand for pushing, for travelling, and at most where it pushes (m).
    LOW, HIGH, STILL_LOW = 0.115, 0.32, 0.16
    #: Displacement of a pushing action at most, when it yields, and along x (m); force that a hand
    #: keeps below (N), and displacement per newton left.
    PACE, YIELD, ALONG, HARDEST, PER_NEWTON = 0.013, 0.006, 0.006, 60.0, 3e-4
    #: Where hands wait with nothing to do (m).
    WAIT = (0.40, 0.56, 0.32)

    def actions(self, view: IntakeView) -> FloatArray:
        """Return actions (n, arms, 3) in [-1, 1], in the frames of the bases."""
        move = shortened(self._move(view), self.step) / self.step
        move[..., 1] *= _OUTWARDS
        return move

    def _move(self, view: IntakeView) -> FloatArray:
        """Return where each hand should go next, (n, arms, 3), from where it is, metres."""
        wrist, elbow = view.joints[:, :, _WRIST], view.joints[:, :, _ELBOW]
        wrist_due, elbow_due = (
            self._due(joint, limit)
            for joint, limit in zip((wrist, elbow), self.LIMITS, strict=True)
        )
        point = np.where(wrist_due[..., None], wrist, elbow)
        tips = wrist + self.HAND * unit(wrist - elbow)
        outer = np.where(wrist_due, np.maximum(wrist, tips)[..., 1], elbow[..., 1]) + self.CLEAR
        aside = outer - BASE_SPACING / 2
        depth = np.sqrt(np.maximum(self.REACH**2 - aside**2, self.LEAST**2))
        x, out, z = np.moveaxis(view.tool, -1, 0)
        ahead = np.clip(point[..., 0], self.LEAST, np.minimum(depth, self.MOST))
        passed = (x > point[..., 0] - self.BEFORE) & (x < point[..., 0] + self.BEHIND)
        pushes = passed & (z < self.STILL_LOW) & (out > point[..., 1])
        there = (np.abs(x - ahead) < self.ARRIVED) & (out > outer - self.ARRIVED)
        along = np.where(pushes, np.clip(ahead - x, -self.ALONG, self.ALONG), ahead - x)
        push = np.clip(self.PER_NEWTON * (self.HARDEST - view.force), -self.YIELD, self.PACE)
        across = np.where(pushes, -push, outer - out)
        height = np.where(pushes | there, self.LOW, self.HIGH) - z
        move = np.stack([along, across, height], axis=-1)
        idle = ~(wrist_due | elbow_due)
        return np.where(idle[..., None], self.WAIT - view.tool, move)

    def _due(self, joint: FloatArray, limit: float) -> Bools:
        """Return which joints (n, arms, 3) are near, and too far out."""
        x, out = joint[..., 0], joint[..., 1]
        due: Bools = (x > self.NEAREST) & (x < self.FARTHEST) & (out > limit)
        return due


def expert(task: Intake, settings: Settings, coordinated: bool, free_arm: int | None) -> Expert:
    """Build the expert of intake; see :func:`saver_envs.experts.make_expert`."""
    skill = IntakeSkill(settings.max_speed * ACTION_DURATION)
    read = partial(IntakeView.of, task)
    return Expert(task, skill.actions, read=read, free_arm=free_arm)
