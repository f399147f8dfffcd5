"""The wrist push skill: come to the wrist's outer side, then press it towards the hip, gently."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from saver_envs.control import shortened
from saver_envs.episodes import DEFAULT_SPEED, Settings
from saver_envs.experts.blocks import ArmView
from saver_envs.experts.expert import Expert
from saver_envs.experts.geometry import FloatArray, dot, length, unit
from saver_envs.simulation import ACTION_DURATION
from saver_envs.tasks.wrist_push import WristPush


@dataclass(frozen=True)
class WristSkill:
    """What each arm does with the wrist at its side; the arms have no need to coordinate.

    A forearm is long: it can be pushed sideways, hardly lengthwise, and the hand cannot go around
    it. So the hand stays on the outer side, where it starts.

    :param step: longest displacement of an action, metres.
    :param inwards: (arms,) 1 where the person lies to the arm's left, -1 where to its right.
    """

    step: float = DEFAULT_SPEED * ACTION_DURATION
    inwards: tuple[float, ...] = (1.0, -1.0)

    #: Distance between the centres of hand and wrist where they touch, and air (m).
    TOUCH, AIR = 0.066, 0.012
    #: Displacement of a pressing action: longest, shortest (m), and share of the way left.
    FASTEST, SLOWEST, GAIN = 0.0040, 0.0016, 0.15
    #: The hand lets go of a wrist this near its target, and pushes it again if it deviates by more
    #: (m).
    LET_GO, TAKE_UP = 0.022, 0.035
    #: Largest angle of the push's direction from straight across the forearm (rad).
    OBLIQUE = np.radians(35.0)
    #: Error along the forearm with which a push may begin, and with which it goes on (m).
    ALIGNED, STILL_ALIGNED = 0.015, 0.030
    #: Share of that error that a pressing action corrects.
    CENTRING = 0.15

    def actions(self, view: ArmView) -> FloatArray:
        """Return actions (n, arms, 3) in [-1, 1].

        :param view: what the arms see.
        """
        tool, wrist = view.tool[..., :2], view.object[..., :2]
        move = shortened(self._waypoint(view, tool, wrist) - tool, self.step) / self.step
        return np.concatenate([move, np.zeros_like(move[..., :1])], axis=-1)

    def _waypoint(self, view: ArmView, tool: FloatArray, wrist: FloatArray) -> FloatArray:
        """Return where each hand should go next, (n, arms, 2) in base frames, metres."""
        way = view.target[..., :2] - wrist
        left = length(way)[..., None]
        w, _, _, z = np.moveaxis(view.object_quaternion, -1, 0)
        yaw = 2 * np.arctan2(z, w)
        # Unit vectors (n, arms, 2) along the forearms, and across them to the body.
        along = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
        across = np.stack([-along[..., 1], along[..., 0]], axis=-1)
        across = across * np.asarray(self.inwards)[:, None]
        # Mostly across the forearm: the direction along it is limited by an angle.
        forward = np.maximum(dot(way, across), 1e-3)
        sideways = dot(way, along)
        limit = np.tan(self.OBLIQUE) * forward
        heading = unit(
            forward[..., None] * across + np.clip(sideways, -limit, limit)[..., None] * along
        )
        relative = tool - wrist
        depth = dot(relative, heading)[..., None]
        aside = relative - depth * heading
        aside_by = length(aside)[..., None]
        touching = depth > -(self.TOUCH + self.AIR)
        tolerance = np.where(touching, self.STILL_ALIGNED, self.ALIGNED)
        outside = dot(relative, across)[..., None] < -0.6 * self.TOUCH
        ready = outside & (aside_by < tolerance)
        pace = np.clip(self.GAIN * left, self.SLOWEST, self.FASTEST)
        closing = np.maximum(-depth - self.TOUCH, 0.0)  # to the wrist, at full speed
        push = tool + heading * np.maximum(closing, pace) - self.CENTRING * aside
        ring = self.TOUCH + self.AIR
        behind = wrist - heading * ring
        clear = wrist + dot(relative, along)[..., None] * along - across * ring
        approach = np.where(outside, behind, clear)
        point = np.where(ready, push, approach)
        # Let go and keep a small distance, so that the arm stays where it lies.
        held = left < np.where(touching, self.LET_GO, self.TAKE_UP)
        inside = dot(way, across)[..., None] < 0.3 * self.LET_GO  # beyond: do not press on
        return np.where(held | inside, wrist - across * (ring + self.AIR), point)


def expert(task: WristPush, settings: Settings, coordinated: bool, free_arm: int | None) -> Expert:
    """Build the expert of wrist push, whose arms never meet and need no coordination.

    See :func:`saver_envs.experts.make_expert`.
    """
    skill = WristSkill(settings.max_speed * ACTION_DURATION)
    return Expert(task, skill.actions, free_arm=free_arm)
