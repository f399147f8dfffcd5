"""The push skill: get behind the cube on a ring clear of it, then drive it to its target."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from saver_envs.control import length, shortened
from saver_envs.episodes import Settings
from saver_envs.experts.blocks import ArmView
from saver_envs.experts.coordination import JACO_CLOSED, alone_or_coordinated
from saver_envs.experts.expert import Expert
from saver_envs.experts.geometry import FloatArray, dot, unit
from saver_envs.experts.skill import Skill
from saver_envs.tasks.push import Push

#: Share of a commanded displacement that a hand makes within the action.
TRACKING = 0.92
#: How much the rough fingers drag a touched cube along, rather than pushing it aside.
DRAG = 0.7
#: A pitched hand's wrist is this much nearer to the base than its tool (m).
WRIST = 0.08
#: Range of predicted hands, x and y in the base frame (m): about that of set-points.
HAND_LOWER, HAND_UPPER = np.array([0.25, -0.48]), np.array([0.60, 0.48])


@dataclass(frozen=True)
class PushSkill(Skill):
    """What each arm does on its own, and a rough prediction of the result.

    :param hand_radius: half the width of the closed hand where it meets the cube, metres.
    :param stop: a push ends if the cube will come to rest this near its target, metres.
    :param good_enough: a push that has deviated is taken up again beyond this distance, metres.
    :param trail: how much wider the ring is on the cube's far side, metres: there a hand that is
        pitched forward, as that of an arm with few joints, has its wrist between tool and cube.
    """

    hand_radius: float = 0.031
    stop: float = 0.015
    good_enough: float = 0.035
    trail: float = 0.0

    #: Air between hand and cube on the ring (m).
    AIR = 0.021
    #: Sideways error within which a push may begin, and go on once in contact (m).
    ALIGNED, STILL_ALIGNED = 0.012, 0.025
    #: Share of the sideways error that a pushing action corrects; more drags the cube along.
    CENTRING = 0.3
    #: A push advances by this share of what is left, so that the cube is slow when it arrives.
    GAIN = 0.4
    #: Deceleration of a sliding cube, friction 0.5 times gravity (m/s^2).
    DECELERATION = 4.9
    #: Targets nearer the workspace's edge than this box are aimed at from inside, by no more than
    #: a share of what success allows (m), so that the hand finds room behind a cube gone too far.
    AIM_SHIFT = 0.015
    AIM_LOWER, AIM_UPPER = (0.315, -0.445), (0.535, 0.445)
    #: Orbits shorter than this ignore the requested side (rad).
    SHORT_TURN = 0.7

    @property
    def ring(self) -> float:
        """Radius around a cube on which a hand passes without touching it, metres."""
        return self.object_size / 2 + self.hand_radius + self.AIR

    def aim(self, view: ArmView) -> FloatArray:
        """Return the points (n, arms, 2) to which cubes are pushed, base frames, metres."""
        target = view.target[..., :2]
        inside = np.clip(target, self.AIM_LOWER, self.AIM_UPPER)
        return target + np.clip(inside - target, -self.AIM_SHIFT, self.AIM_SHIFT)

    def finished(self, view: ArmView) -> NDArray[np.bool_]:
        """Return which cubes (n, arms) lie where they are meant to."""
        result: NDArray[np.bool_] = length(self.aim(view) - view.object[..., :2]) < self.good_enough
        return result

    def waypoint(self, view: ArmView, side: FloatArray) -> FloatArray:
        """Return where each hand should go next, (n, arms, 2) in base frames, metres.

        :param view: what the arms see.
        :param side: (n, arms) way round the own cube: 1 anticlockwise, -1 clockwise, 0 the shorter.
        """
        tool, cube = view.tool[..., :2], view.object[..., :2]
        velocity = view.object_velocity[..., :2]
        target = self.aim(view)
        heading = unit(target - cube)
        coasting = velocity * length(velocity)[..., None] / (2 * self.DECELERATION)
        left = length(target - cube - coasting)[..., None]
        relative = tool - cube
        along = dot(relative, heading)[..., None]
        lateral = relative - along * heading
        deviation = length(lateral)[..., None]
        half = self.object_size / 2
        is_behind = along < -half
        near = along > -(self.ring + 0.01)
        aligned = is_behind & (deviation < np.where(near, self.STILL_ALIGNED, self.ALIGNED))
        push = tool - self.CENTRING * lateral + heading * np.minimum(self.GAIN * left, self.step)
        behind = cube - heading * (self.ring + self._trail(cube, -heading))[..., None]
        straight = is_behind & (deviation < half)
        approach = np.where(straight, behind, self._orbit(cube, relative, heading, side))
        point = np.where(aligned, push, approach)
        rests = (left < self.stop) | (~aligned & (left < self.good_enough))
        return np.where(rests, tool, point)

    def _orbit(
        self, cube: FloatArray, relative: FloatArray, heading: FloatArray, side: FloatArray
    ) -> FloatArray:
        """Return the place behind the cube if the way there is free, else a point on the ring."""
        own = np.arctan2(relative[..., 1], relative[..., 0])
        goal = np.arctan2(-heading[..., 1], -heading[..., 0])
        turn = (goal - own + np.pi) % (2 * np.pi) - np.pi
        long_way = (side * turn < 0) & (np.abs(turn) > self.SHORT_TURN)
        turn = np.where(long_way, turn + 2 * np.pi * side, turn)
        distance = length(relative)
        tangent = np.arccos(np.clip(self.ring / np.maximum(distance, self.ring), 0, 1))
        free = np.abs(turn) <= tangent
        ahead = own + np.sign(turn) * np.minimum(np.abs(turn), np.maximum(tangent, 0.3))
        circle = np.stack([np.cos(ahead), np.sin(ahead)], axis=-1)
        direction = np.where(free[..., None], -heading, circle)
        radius = (self.ring + self._trail(cube, direction)) * np.where(free, 1.0, 1.03)
        return cube + radius[..., None] * direction

    def _trail(self, cube: FloatArray, direction: FloatArray) -> FloatArray:
        """What is added to the ring in ``direction`` from the cube, (n, arms), metres."""
        return self.trail * np.maximum(dot(unit(cube), direction), 0.0)

    def actions(self, view: ArmView, side: FloatArray | None = None) -> FloatArray:
        """Return actions (n, arms, 3) in [-1, 1] of arms that ignore one another.

        :param view: what the arms see.
        :param side: see :meth:`waypoint`; the shorter ways by default.
        """
        side = np.zeros(view.tool.shape[:2]) if side is None else side
        move = shortened(self.waypoint(view, side) - view.tool[..., :2], self.step) / self.step
        return np.concatenate([move, np.zeros_like(move[..., :1])], axis=-1)

    def imagine(self, view: ArmView, actions: FloatArray, base: FloatArray) -> ArmView:
        """Predict what the arms see after ``actions``, roughly: discs that push discs.

        :param view: what they see now.
        :param actions: (n, arms, 3).
        :param base: (arms, 2) base positions of a row, metres.
        """
        tool = view.tool.copy()
        tool[..., :2] += TRACKING * self.step * actions[..., :2]
        tool[..., :2] = np.clip(tool[..., :2], HAND_LOWER, HAND_UPPER)
        cubes: FloatArray = view.object[..., :2] + base
        for part in self._hand(tool[..., :2]):
            cubes = self._pushed(part + base, actions[..., :2], cubes)
        for arm in range(tool.shape[1] - 1):
            gap = cubes[:, arm + 1] - cubes[:, arm]
            distance = length(gap)[:, None]
            apart = gap * np.maximum(self.object_size * 1.1 / np.maximum(distance, 1e-6) - 1, 0) / 2
            cubes[:, arm] -= apart
            cubes[:, arm + 1] += apart
        moved = np.concatenate([cubes - base, view.object[..., 2:]], axis=-1)
        return replace(view, tool=tool, object=moved, object_velocity=0 * view.object_velocity)

    def _hand(self, tool: FloatArray) -> list[FloatArray]:
        """Centres of the discs that a hand consists of, (n, arms, 2) each, metres."""
        return [tool] if self.trail == 0 else [tool, tool - WRIST * unit(tool)]

    def _pushed(self, hand: FloatArray, motion: FloatArray, cubes: FloatArray) -> FloatArray:
        """Cubes (n, arms, 2) moved out of the discs ``hand``, dragged along by their motion."""
        touch = self.object_size / 2 + self.hand_radius
        for arm in range(hand.shape[1]):
            gap = cubes - hand[:, arm, None]
            overlap = np.maximum(touch - length(gap), 0)[..., None]
            direction = unit(unit(gap) + DRAG * unit(motion[:, arm, None]))
            cubes = cubes + overlap * direction
        return cubes


#: What differs between robots' hands: the MICO's is pitched.
SKILLS = {"mico": PushSkill(trail=0.02)}


def expert(task: Push, settings: Settings, coordinated: bool, free_arm: int | None) -> Expert:
    """Build the expert of push; see :func:`saver_envs.experts.make_expert`."""
    skill = SKILLS.get(settings.robot.name, PushSkill()).fitted(settings, task.object_size)
    return alone_or_coordinated(task, settings, skill, JACO_CLOSED, coordinated, free_arm)
