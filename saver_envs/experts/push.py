"""The push expert of one arm: get behind the cube, then drive it to its target."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saver_envs.core import ACTION_DURATION, DEFAULT_SPEED
from saver_envs.experts.blocks import ArmView
from saver_envs.experts.coordination import Way, give_way, go_round, stop_before_hands

FloatArray = NDArray[np.floating]


@dataclass(frozen=True)
class PushExpert:
    """Orbits the cube at a clear distance until it is behind it, then pushes through its centre.

    :param object_size: edge of the cube, metres.
    :param step: longest displacement of an action, metres.
    """

    object_size: float = 0.056
    step: float = DEFAULT_SPEED * ACTION_DURATION

    #: The cube is left alone where it will come to rest within this distance of its target (m).
    STOP = 0.015
    #: Within this distance an arm has nothing left to do and yields (m).
    DONE = 0.025
    #: Orbit: half the cube's diagonal, half a closed hand and some air, beside half the edge (m).
    ORBIT_GAP = 0.062
    #: Behind the cube the hand stands this far from its face (m).
    BEHIND_GAP = 0.045
    #: Sideways error within which a push may begin, and go on once in contact (m).
    ALIGNED, STILL_ALIGNED = 0.012, 0.022
    #: A push advances by this share of what is left (1), so that the cube is slow when it arrives.
    PUSH_GAIN = 0.35
    #: Deceleration of a sliding cube, friction 0.5 times gravity (m/s^2).
    DECELERATION = 4.9

    def waypoint(self, view: ArmView) -> FloatArray:
        """Return where each hand should go next, (n, arms, 2) in base frames, metres."""
        tool = view.tool[..., :2]
        velocity = view.object_velocity[..., :2]
        speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
        coasting = velocity * speed / (2 * self.DECELERATION)
        cube = view.object[..., :2]
        away = view.target[..., :2] - cube
        heading = _unit(away)
        left = view.target[..., :2] - (cube + coasting)
        distance = np.linalg.norm(left, axis=-1, keepdims=True)
        relative = tool - cube
        along = np.sum(relative * heading, axis=-1, keepdims=True)
        lateral = relative - along * heading
        sideways = np.linalg.norm(lateral, axis=-1, keepdims=True)
        half = self.object_size / 2
        behind = cube - heading * (half + self.BEHIND_GAP)
        in_contact = along > -(half + self.BEHIND_GAP)
        aligned = (along < -half) & (
            sideways < np.where(in_contact, self.STILL_ALIGNED, self.ALIGNED)
        )
        push = tool - lateral + heading * np.minimum(self.PUSH_GAIN * distance, self.step)
        approach = np.where(
            (along < -(half + 0.5 * self.BEHIND_GAP)) & (sideways < half),
            behind,
            self._orbit(cube, relative, heading, behind),
        )
        point = np.where(aligned, push, approach)
        return np.where(distance < self.STOP, tool, point)

    def _orbit(
        self, cube: FloatArray, relative: FloatArray, heading: FloatArray, behind: FloatArray
    ) -> FloatArray:
        """A point further round the cube on a circle clear of it, or straight to ``behind``."""
        radius = self.object_size / 2 + self.ORBIT_GAP
        own = np.arctan2(relative[..., 1], relative[..., 0])
        goal = np.arctan2(-heading[..., 1], -heading[..., 0])
        turn = (goal - own + np.pi) % (2 * np.pi) - np.pi
        ahead = own + np.clip(turn, -0.45, 0.45)
        circle = cube + radius * np.stack([np.cos(ahead), np.sin(ahead)], axis=-1)
        near = np.abs(turn)[..., None] < 0.6
        return np.where(near, behind, circle)

    def actions(self, view: ArmView) -> FloatArray:
        """Return actions (n, arms, 3) in [-1, 1] of arms that ignore one another."""
        return self._action(self.waypoint(view) - view.tool[..., :2])

    def coordinated_actions(self, view: ArmView, base: FloatArray) -> FloatArray:
        """Return actions (n, arms, 3) in [-1, 1] of arms that give way to one another.

        :param view: what the arms see.
        :param base: (arms, 2) base positions of a row, metres; the frames are parallel.
        """
        wanted = self.waypoint(view) + base
        tool, cube = view.tool[..., :2] + base, view.object[..., :2] + base
        way = self._way(view, base)
        goal, turned = give_way(way, wanted)
        move = _shortened(goal - tool, self.step)
        everyone = np.ones(turned.shape, dtype=bool)
        for other in range(1, tool.shape[1]):
            move = go_round(tool, move, np.roll(cube, other, axis=1), everyone)
        move = go_round(tool, move, cube, turned | (way.left == 0))
        return self._action(stop_before_hands(tool, move, turned))

    def _way(self, view: ArmView, base: FloatArray) -> Way:
        """The hand's way behind the cube and on to where the cube is at its target."""
        tool, cube, target = (
            points[..., :2] + base for points in (view.tool, view.object, view.target)
        )
        away = target - cube
        distance = np.linalg.norm(away, axis=-1)
        done = distance < self.DONE
        behind = _unit(away) * (self.object_size / 2 + self.BEHIND_GAP)
        corners = np.stack([tool, cube - behind, target - behind], axis=2)
        corners = np.where(done[..., None, None], tool[..., None, :], corners)
        left = np.linalg.norm(np.diff(corners, axis=2), axis=-1).sum(axis=-1)
        return Way(corners, cube, target, np.where(done, 0.0, left))

    def _action(self, move: FloatArray) -> FloatArray:
        move = _shortened(move, self.step) / self.step
        return np.concatenate([move, np.zeros_like(move[..., :1])], axis=-1)


def _unit(vectors: FloatArray) -> FloatArray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.maximum(length, 1e-6)


def _shortened(vectors: FloatArray, longest: float) -> FloatArray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors * np.minimum(1.0, longest / np.maximum(length, 1e-9))
