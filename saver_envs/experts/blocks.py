"""Splits observations into named parts, one row per arm, for all experts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saver_envs.experts.geometry import FloatArray, length
from saver_envs.robots.description import Fingers
from saver_envs.tasks.contract import PENDING, Task


@dataclass(frozen=True)
class ArmView:
    """What the arms see, each in its own base frame; leading dimensions (n, arms).

    :param tool: (n, arms, 3), metres.
    :param tool_velocity: (n, arms, 3), averaged over the last actions, metres per second.
    :param top_speed: (n, arms), the greatest of any arm so far, of these averages, metres per
        second; 0 until they have had time to move.
    :param fingers: (n, arms, 3), radians.
    :param finger_velocity: (n, arms, 3), radians per second.
    :param object: (n, arms, 3), metres.
    :param object_quaternion: (n, arms, 4), w first.
    :param object_velocity: (n, arms, 3), metres per second.
    :param target: (n, arms, 3), metres.
    :param object_size: (n, arms) edges of the objects, metres.
    :param table: (n, arms) height of the table above the bases where held hands show it, else 0,
        metres.
    :param begins: (n,) whether an episode begins with this observation.
    """

    tool: FloatArray
    tool_velocity: FloatArray
    top_speed: FloatArray
    fingers: FloatArray
    finger_velocity: FloatArray
    object: FloatArray
    object_quaternion: FloatArray
    object_velocity: FloatArray
    target: FloatArray
    object_size: FloatArray
    table: FloatArray
    begins: NDArray[np.bool_]


class Viewer:
    """Reads observations, and remembers of each episode what its beginning shows.

    A resting object's centre is half its size above the table. Hands that are held at a known
    height above the table show where that is; else it is taken to be level with the bases.
    A new target or a hand that jumped marks a new episode.

    :param task: says where the parts lie; each arm has an object with a position as its goal.
    """

    #: A hand that moved by more than this at once (m) belongs to a new episode.
    JUMP = 0.06
    #: Sizes that a resting object may have (m).
    SIZES = (0.03, 0.13)
    #: A size this near that of the task (m) is taken for it: where it follows from the height of
    #: held hands, and where objects are seen at rest, without errors.
    ALIKE, SAME = 0.004, 0.001
    #: Heights of targets, which have no errors, are equal within this (m).
    EXACT = 1e-5
    #: Objects that lie on the table are seen at heights that differ by less than this (m).
    LEVEL = 0.025
    #: Observations over which heights are averaged at the beginning of an episode, and after which
    #: arms have moved at their full speed.
    BEGINNING, MOVED = 10, 15
    #: Mean finger angle of a hand that holds an object (rad), and how near that is (m).
    CLOSED, WITHIN = 0.35, 0.06
    #: Weight of an observation in the average of the tools' velocities.
    NEWEST = 0.25

    def __init__(self, task: Task) -> None:
        self.task = task
        self._usual = float(getattr(task, "object_size", 0.0))
        self._last: ArmView | None = None
        # Observations since the beginning (n,), and means (n, arms) of heights over the first ones.
        self._age = np.zeros(0, dtype=np.intp)
        # Greatest averaged speed (n,), metres per second.
        self._top: FloatArray = np.zeros(0)
        self._tool: FloatArray = np.zeros((0, task.n_arms))
        self._object: FloatArray = np.zeros((0, task.n_arms))

    def __call__(self, observation: dict[str, FloatArray]) -> ArmView:
        """Split a batched goal-conditioned observation.

        :param observation: arrays with a leading dimension n: ``observation`` and
            ``desired_goal``; the same episodes in the same order at every call.
        :return: the parts.
        """
        task = self.task
        layout, seen = task.observation_layout, observation["observation"]
        velocity = layout.part("object linear velocity")
        finger_velocity = layout.part("finger velocities")
        tool_velocity = layout.part("gripper linear velocity")
        tool = layout.get(seen, "gripper position")
        position = layout.get(seen, "object position")
        target = task.goal_layout.get(observation["desired_goal"], "object position")
        fingers = layout.get(seen, "finger positions")
        if task.observe_pending_motion:
            # Where the hands, and what they hold, will be when what is decided now takes effect.
            pending = layout.get(seen, PENDING.name)
            held = self._held(position - tool, fingers)
            tool, position = tool + pending, np.where(held, position + pending, position)
        begins = self._begins(tool, target)
        moving = layout.get(seen, tool_velocity.name) / tool_velocity.scale
        if self._last is not None and self._last.tool.shape == tool.shape:
            share = np.where(begins, 1.0, self.NEWEST)[:, None, None]
            moving = self._last.tool_velocity + share * (moving - self._last.tool_velocity)
        size, table, excess = self._heights(tool, position, target, begins)
        position = position.copy()
        position[..., 2] -= excess
        self._last = ArmView(
            tool=tool,
            tool_velocity=moving,
            top_speed=self._top_speed(length(moving).max(axis=1), begins),
            fingers=fingers,
            finger_velocity=layout.get(seen, finger_velocity.name) / finger_velocity.scale,
            object=position,
            object_quaternion=layout.get(seen, "object orientation, a quaternion with w >= 0"),
            object_velocity=layout.get(seen, velocity.name) / velocity.scale,
            target=target,
            object_size=size,
            table=table,
            begins=begins,
        )
        return self._last

    def _held(self, offset: FloatArray, fingers: FloatArray) -> FloatArray:
        """Return which objects at ``offset`` (n, arms, 3) from the tools are held, (n, arms, 1)."""
        closed = fingers.mean(axis=-1) > self.CLOSED
        near = length(offset) < self.WITHIN
        grasps = self.task.fingers is Fingers.ACTUATED
        return (closed & near & grasps)[..., None]

    def _begins(self, tool: FloatArray, target: FloatArray) -> NDArray[np.bool_]:
        """Return whether an episode begins, (n,)."""
        last = self._last
        if last is None or last.target.shape != target.shape:
            return np.ones(len(target), dtype=bool)
        begins: NDArray[np.bool_] = (last.target != target).any(axis=(1, 2))
        return begins | (length(tool - last.tool) > self.JUMP).any(axis=1)

    def _top_speed(self, speed: FloatArray, begins: NDArray[np.bool_]) -> FloatArray:
        """Update the greatest speed (n,), and return it for each arm (n, arms) once it is known."""
        last = self._top if len(self._top) == len(speed) else np.zeros_like(speed)
        self._top = np.where(begins, speed, np.maximum(last, speed))
        known = np.where(self._age < self.MOVED, 0.0, self._top)
        return np.broadcast_to(known[:, None], (len(speed), self.task.n_arms))

    def _heights(
        self, tool: FloatArray, position: FloatArray, target: FloatArray, begins: NDArray[np.bool_]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the edges of objects, the height of the table, and the error of objects' heights.

        :return: (n, arms) each, metres; seen heights less the error are corrected.
        """
        if len(self._age) != len(begins):
            self._age = np.zeros(len(begins), dtype=np.intp)
            self._tool, self._object = tool[..., 2].copy(), position[..., 2].copy()
        self._age = np.where(begins, 0, self._age + 1)
        early = self._age < self.BEGINNING
        share = (early / (self._age + 1.0))[:, None]
        self._tool = self._tool + share * (tool[..., 2] - self._tool)
        self._object = self._object + share * (position[..., 2] - self._object)
        held = self.task.held_height
        if held is None:
            rest = self._resting(target[..., 2])
            return self._size(rest, self.SAME), np.zeros_like(rest), self._object - rest
        # Pushed objects stay on the table, so that their targets show their height without errors.
        # Targets at that of the usual objects on a table level with the bases mean just these:
        # hands of weak servos are not where they are held.
        height = target[..., 2]
        usual = np.abs(height - self._usual / 2).max(axis=1, keepdims=True) < self.EXACT
        raised = np.where(usual, 0.0, self._tool.mean(axis=1, keepdims=True) - held)
        table = np.broadcast_to(raised, height.shape)
        return self._size(height - table, self.ALIKE), table, np.zeros_like(table)

    def _resting(self, target: FloatArray) -> FloatArray:
        """Estimate the heights of the centres of resting objects.

        All objects have the same size, so the mean over arms has a smaller error. A target at about
        that height is on the table, and its height has no error.

        :param target: (n, arms) heights of the targets, metres.
        :return: (n, arms), metres.
        """
        seen = self._object
        lying = seen < seen.min(axis=1, keepdims=True) + self.LEVEL
        mean = np.mean(seen, axis=1, keepdims=True, where=lying)
        gap = np.abs(target - mean)
        nearest = np.take_along_axis(target, gap.argmin(axis=1)[:, None], axis=1)
        unusual = np.abs(2 * mean - self._usual) > self.SAME
        rest = np.where(unusual & (gap.min(axis=1, keepdims=True) < self.LEVEL / 2), nearest, mean)
        return np.where(lying, rest, seen)

    def _size(self, height: FloatArray, alike: float) -> FloatArray:
        """Edges of objects whose centres are at ``height`` above the table, metres."""
        size, usual = 2 * height, self._usual
        resting = size < self.SIZES[1]
        size = np.maximum(size, self.SIZES[0])
        return np.where(resting & (np.abs(size - usual) > alike), size, usual)
