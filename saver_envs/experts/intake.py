"""The intake expert: each hand sweeps the limbs at its side inwards before they reach its rail."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from saver_envs.control import shortened
from saver_envs.episodes import Settings
from saver_envs.experts.expert import Expert
from saver_envs.experts.geometry import FloatArray, unit
from saver_envs.scenes import BASE_SPACING
from saver_envs.simulation import ACTION_DURATION
from saver_envs.tasks.contract import Task
from saver_envs.tasks.intake import ENTRANCE, Intake
from saver_envs.tasks.limbs import LIMB_JOINTS, POSITIONS

#: Outwards along y, arm by arm.
_OUTWARDS: Final = np.array([-1.0, 1.0])


@dataclass(frozen=True)
class IntakeView:
    """What the arms see; x forwards from the bases, then outwards from the midline, then up.

    :param tool: (n, arms, 3), metres.
    :param joints: (n, arms, joints, 3) ankles, knees, wrists, elbows, metres.
    """

    tool: FloatArray
    joints: FloatArray

    @classmethod
    def of(cls, task: Task, observation: dict[str, FloatArray]) -> Self:
        """Read a batched goal-conditioned observation."""
        layout, seen = task.observation_layout, observation["observation"]
        joints = np.stack([layout.get(seen, part.name) for part in POSITIONS], axis=2)
        return cls(
            tool=_outwards(layout.get(seen, "gripper position"), _OUTWARDS),
            joints=_outwards(joints, _OUTWARDS[:, None]),
        )


def _outwards(points: FloatArray, sign: FloatArray) -> FloatArray:
    """Return points with y counted from the midline, outwards."""
    result = points.copy()
    result[..., 1] = BASE_SPACING / 2 + sign * points[..., 1]
    return result


@dataclass(frozen=True)
class IntakeSkill:
    """What each arm does with the limbs at its side; the arms have no need to coordinate.

    :param step: longest displacement of an action, metres.
    """

    step: float

    #: How far out ankles, knees, wrists and elbows may be (m), and how far in they are pushed.
    LIMITS = (0.21, 0.22, 0.25, 0.25)
    DEEPER = 0.02
    #: Hands attend to joints from the nearest place to the farthest along x, and reach so far (m).
    NEAREST, FARTHEST, REACH = ENTRANCE, 0.80, 0.45
    #: Distance between the middle of the hand and a joint where they touch (m), and clearance.
    TOUCH, CLEAR = 0.055, 0.03
    #: Height of the hand for pushing and for travelling (m).
    LOW, HIGH = 0.115, 0.32
    #: How well it has to be aligned with the joint along x (m).
    ALIGNED = 0.05
    #: Displacement of a pushing action (m).
    PACE = 0.02
    #: From a wrist to its fingertips (m).
    HAND = 0.18
    #: Where hands wait (m).
    WAIT = (0.36, 0.52, 0.34)

    def actions(self, view: IntakeView) -> FloatArray:
        """Return actions (n, arms, 3) in [-1, 1], in the frames of the bases."""
        move = shortened(self._waypoint(view) - view.tool, self.step) / self.step
        move[..., 1] *= _OUTWARDS
        return move

    def _waypoint(self, view: IntakeView) -> FloatArray:
        """Return where each hand should go next, (n, arms, 3)."""
        x, out = view.joints[..., 0], view.joints[..., 1]
        limits = np.array(self.LIMITS)
        due = (x > self.NEAREST) & (x < self.FARTHEST) & (out > limits)
        first = np.where(due, x, np.inf).argmin(axis=-1)[..., None]
        point = np.take_along_axis(view.joints, first[..., None], 2)[..., 0, :]
        wanted = limits[first[..., 0]] - self.DEEPER
        tool = view.tool
        beside = tool[..., 1] - point[..., 1]
        aligned = np.abs(tool[..., 0] - point[..., 0]) < self.ALIGNED
        ready = np.abs(tool[..., 0] - np.minimum(point[..., 0], self.REACH)) < self.ALIGNED
        outside = beside > 0.2 * self.TOUCH
        low = tool[..., 2] < self.LOW + 0.03
        pushing = aligned & outside & low
        target = tool.copy()
        target[..., 0] = np.minimum(point[..., 0], self.REACH)
        clear = np.maximum(point[..., 1], self._fingertips(view)) + self.TOUCH + self.CLEAR
        inwards = np.maximum(tool[..., 1] - self.PACE, wanted + self.TOUCH)
        quick = np.maximum(point[..., 1] + self.TOUCH, wanted + self.TOUCH)
        push_to = np.where(beside > self.TOUCH + 0.02, quick, inwards)
        target[..., 1] = np.where(pushing, push_to, clear)
        down = pushing | (ready & (tool[..., 1] > clear - 0.04))
        target[..., 2] = np.where(down, self.LOW, self.HIGH)
        idle = ~due.any(axis=-1)
        return np.where(idle[..., None], np.array(self.WAIT), target)

    def _fingertips(self, view: IntakeView) -> FloatArray:
        """Return how far out the person's fingertips are (n, arms), metres."""
        wrist, elbow = (view.joints[:, :, LIMB_JOINTS.index(one)] for one in ("wrist", "elbow"))
        return (wrist + self.HAND * unit(wrist - elbow))[..., 1]


def expert(task: Intake, settings: Settings, coordinated: bool, free_arm: int | None) -> Expert:
    """Build the expert of intake; see :func:`saver_envs.experts.make_expert`."""
    skill = IntakeSkill(settings.max_speed * ACTION_DURATION)

    def act(view: IntakeView) -> NDArray[np.float64]:
        actions = skill.actions(view)
        if free_arm is not None:
            actions[:, np.arange(task.n_arms) != free_arm] = 0.0
        return actions

    return Expert(task, act, read=lambda seen: IntakeView.of(task, seen))
