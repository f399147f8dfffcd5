"""The push skill: get behind the cube on a ring clear of it, then drive it to its target."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from saver_envs.control import shortened
from saver_envs.episodes import Settings
from saver_envs.experts.blocks import ArmView
from saver_envs.experts.coordination import JACO_CLOSED, alone_or_coordinated
from saver_envs.experts.expert import Expert
from saver_envs.experts.geometry import FloatArray, dot, length, rotated, unit, way_round, wrapped
from saver_envs.experts.skill import Skill
from saver_envs.tasks.push import Push
from saver_envs.tasks.sampling import BELOW_WRIST

#: Share of a commanded displacement that a hand makes within the action.
TRACKING = 1.0
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
    :param palm_radius: the same where a cube is so high that it meets the palm, metres.
    :param stop: a push ends if the cube will come to rest this near its target, metres.
    :param good_enough: a push that has deviated is taken up again beyond this distance, metres.
    :param trail: how much wider the ring is on the cube's far side, metres: there a hand that is
        pitched forward, as that of an arm with few joints, has its wrist between tool and cube.
    :param gentle: whether cubes may glide: hands push slowly, except where a cube that resists
        tips over its edge and lifts them.
    :param upright_at, lead: ``upright_at`` and ``wrist_lead`` of a robot with such a hand.
    """

    hand_radius: float = 0.031
    palm_radius: float = 0.046
    stop: float = 0.015
    good_enough: float = 0.035
    trail: float = 0.0
    gentle: bool = False
    upright_at: float = 0.0
    lead: float = 0.0

    low: ClassVar[bool] = True
    #: Air between hand and cube on the ring (m).
    AIR = 0.025
    #: Sideways error within which a push may begin, and go on once in contact (m).
    ALIGNED, STILL_ALIGNED = 0.012, 0.025
    #: Share of the sideways error that a pushing action corrects; more drags the cube along, and
    #: any does where the wrist of a pitched hand leans on a high one.
    CENTRING = 0.3
    #: A push advances by this share of what is left, so that the cube is slow when it arrives.
    GAIN = 0.3
    #: Share of the way to behind the cube that an action covers, of low cubes and of high ones that
    #: a pitched hand pushes; below 1 for delayed actions.
    APPROACH, HIGH_APPROACH = 0.4, 0.6
    #: Deceleration of a sliding cube, friction 0.5 times gravity (m/s^2).
    DECELERATION = 4.9
    #: Targets nearer the workspace's edge than this box are aimed at from inside, by no more than
    #: a share of what success allows (m), so that the hand finds room behind a cube gone too far.
    AIM_SHIFT = 0.015
    AIM_LOWER, AIM_UPPER = (0.315, -0.445), (0.535, 0.445)
    #: By how much less than the ring a hand may be from another cube (m): on its way past it,
    #: where it begins a push beside it, and where it goes on with one.
    BERTH, BESIDE, GOES_ON = 0.008, 0.012, 0.020
    #: Air that a hand on the ring needs at least on the other side, to pass between two cubes (m).
    PASSAGE = 0.006
    #: By how much a requested side outweighs the detours in the choice of where to begin (rad).
    PREFER = 1.5
    #: A hand whose tool is less or more than this above the table (m) is jammed, with its fingers
    #: on the table or under the cube, and backs off.
    SUNK, RAISED, RAISED_GENTLY = 0.0195, 0.031, 0.04
    #: Cubes glide where friction may be lower than this.
    SLIPPERY = 0.3
    #: Displacement of a gentle push in an action (m), by hands that are not lifted as high as this
    #: above the table (m).
    GENTLY, LIFTED = 0.012, 0.0275
    #: Weight of the hand's way, besides the detour, where a push has to begin aside (1).
    NEARER = 0.5
    #: Orbits shorter than this ignore the requested side (rad).
    SHORT_TURN = 0.7
    #: Furthest from its base from where a pitched hand pushes a high cube (m): a little more than
    #: it gets, since it need not be exactly behind the cube.
    REACH = 0.515
    #: A pitched hand pushes high cubes this much more inward than straight to the target (rad):
    #: they drift outwards, from where it can hardly get them back.
    INWARD = 0.15
    #: A hand this near the edge of its workspace (m) goes along it.
    EDGE = 0.01

    def ring(self, size: FloatArray) -> FloatArray:
        """Return the radii around cubes of edges ``size`` on which a hand touches none, metres."""
        return self.touch(size) + self.AIR

    def touch(self, size: FloatArray) -> FloatArray:
        """Return the distances of hands from cubes of edges ``size`` that they push, metres."""
        return size / 2 + np.where(size > BELOW_WRIST, self.palm_radius, self.hand_radius)

    def aim(self, view: ArmView) -> FloatArray:
        """Return the points (n, arms, 2) to which cubes are pushed, base frames, metres."""
        target = view.target[..., :2]
        inside = np.clip(target, self.AIM_LOWER, self.AIM_UPPER)
        return target + np.clip(inside - target, -self.AIM_SHIFT, self.AIM_SHIFT)

    def finished(self, view: ArmView) -> NDArray[np.bool_]:
        """Return which cubes (n, arms) lie where they are meant to."""
        return length(self.aim(view) - view.object[..., :2]) < self.good_enough

    def places(self, view: ArmView) -> tuple[FloatArray, ...]:
        """Return where hands begin and end their pushes, (n, arms, 2)."""
        cube, target = view.object[..., :2], self.aim(view)
        behind = self.ring(view.object_size)[..., None] * unit(target - cube)
        return cube - behind, target - behind

    def waypoint(self, view: ArmView, side: FloatArray, others: FloatArray) -> FloatArray:
        """Return where each hand should go next, (n, arms, 2) in base frames, metres.

        :param view: what the arms see.
        :param side: (n, arms) way round the own cube: 1 anticlockwise, -1 clockwise, 0 the shorter.
        :param others: (n, arms, k, 3) x and y of other cubes, that the hand shall not touch, in
            base frames, and their edges, metres.
        """
        tool, cube = view.tool[..., :2], view.object[..., :2]
        velocity = view.object_velocity[..., :2]
        target = self.aim(view)
        relative = tool - cube
        half, ring = view.object_size[..., None] / 2, self.ring(view.object_size)[..., None]
        berth = self.ring(others[..., 2])
        others = others[..., :2]
        gaps: FloatArray = others - cube[..., None, :]
        direct: FloatArray = unit(target - cube)
        high = self._meets_wrist(view.object_size)[..., None]
        wanted = np.where(high, self._inward(cube, direct), direct)
        attainable = self._attainable(cube, view.object_size, wanted)
        heading = self._clear_of(gaps, berth, ring, attainable, relative, side)
        coasting = velocity * length(velocity)[..., None] / (2 * self.DECELERATION)
        left = length(target - cube - coasting)[..., None]
        along = dot(relative, heading)[..., None]
        lateral = relative - along * heading
        deviation = length(lateral)[..., None]
        is_behind = along < -half
        near = along > -(ring + 0.01)
        aligned = is_behind & (deviation < np.where(near, self.STILL_ALIGNED, self.ALIGNED))
        # A hand that cannot get behind its cube drags it along with the rough fingers.
        drags = (dot(attainable, wanted) < 1 - 1e-3)[..., None]
        drive = np.where(drags, direct, heading)
        push = tool - np.where(high | drags, 0.0, self.CENTRING) * lateral
        height = (view.tool[..., 2] - view.table)[..., None]
        push = push + drive * np.minimum(self.GAIN * left, self._advance(height))
        away = length(cube - heading * ring)
        trail = self._trail(cube, -heading, view.object_size, away)[..., None]
        gap = -relative - heading * (ring + trail)
        own = ring + self._trail(cube, unit(relative), view.object_size, length(tool))[..., None]
        own = np.where(high, ring, own)
        own = own * (1 - 0.9 * (is_behind & (deviation < half)))
        room = length(gaps) - ring
        passable = room > berth - self.AIR + self.PASSAGE
        berth = berth - self.BERTH
        berth = np.where(passable, np.minimum(room, berth), berth)
        radius: FloatArray = np.concatenate([own, berth], axis=-1)
        ways = [-relative[..., None, :], others - tool[..., None, :]]
        discs: FloatArray = np.concatenate(ways, axis=-2)
        if self.trail > 0:
            gaps, passable, discs, radius = self._with_wrist(
                view, own - self.AIR, gaps, passable, discs, radius
            )
        side = self._side(relative, -heading, gaps, passable, side)
        way = way_round(gap, discs, radius, side)
        if self.trail > 0:
            at_edge = (tool < HAND_LOWER + self.EDGE) & (way < 0)
            way = unit(np.where(high & at_edge, 0.0, way))
        share = np.where(high, self.HIGH_APPROACH, self.APPROACH)
        approach = tool + share * length(gap)[..., None] * way
        point = np.where(aligned, push, approach)
        rests = (left < self.stop) | (~aligned & (left < self.good_enough))
        jammed = (height < self.SUNK) | (height > self._raised)
        return np.where(jammed, tool + self.step * unit(relative), np.where(rests, tool, point))

    @property
    def _raised(self) -> float:
        """Height of tools above the table beyond which hands are jammed, metres."""
        return self.RAISED_GENTLY if self.gentle else self.RAISED

    def _advance(self, height: FloatArray) -> FloatArray:
        """Return the longest displacement of a push by hands at a height above the table, m."""
        slow = self.gentle & (height < self.LIFTED)
        return np.minimum(np.where(slow, self.GENTLY, self.step), self.step)

    def _with_wrist(
        self,
        view: ArmView,
        radius: FloatArray,
        gaps: FloatArray,
        passable: NDArray[np.bool_],
        discs: FloatArray,
        radii: FloatArray,
    ) -> tuple[FloatArray, NDArray[np.bool_], FloatArray, FloatArray]:
        """Add what a pitched hand may not do beyond a high cube, where its wrist would meet it.

        :param radius: (n, arms, 1) of the disc that the tool has to pass, metres.
        :param gaps, passable: as in :meth:`_side`; the far side may be impassable.
        :param discs, radii: as in :func:`way_round`, of which the last one is for the wrist.
        """
        tool, cube, size = view.tool[..., :2], view.object[..., :2], view.object_size
        high = self._meets_wrist(size)
        wrist = self._trail(cube, unit(cube), size, length(tool))[..., None] * unit(cube)
        beyond = self._away(cube, size, np.zeros(1)) < self.REACH
        return (
            np.concatenate([gaps, unit(cube)[..., None, :]], axis=-2),
            np.concatenate([passable, beyond | ~high[..., None]], axis=-1),
            np.concatenate([discs, (cube + wrist - tool)[..., None, :]], axis=-2),
            np.concatenate([radii, np.where(high[..., None], radius, 0.0)], axis=-1),
        )

    def _side(
        self,
        relative: FloatArray,
        goal: FloatArray,
        others: FloatArray,
        passable: NDArray[np.bool_],
        side: FloatArray,
    ) -> FloatArray:
        """Return the way round the own cube (n, arms): the shorter one that no cube blocks.

        :param relative: (n, arms, 2) from the own cube to the hand, metres.
        :param goal: (n, arms, 2) from the own cube to where the hand is to be.
        :param others: (n, arms, k, 2) from the own cube to others, metres.
        :param passable: (n, arms, k) whether a hand fits between them and the own cube.
        :param side: (n, arms) the requested way; 0 for none. Short ways ignore it.
        """
        own = np.arctan2(relative[..., 1], relative[..., 0])
        turn = wrapped(np.arctan2(goal[..., 1], goal[..., 0]) - own)
        other = wrapped(np.arctan2(others[..., 1], others[..., 0]) - own[..., None])
        sign = np.where(turn >= 0, 1.0, -1.0)
        between = ~passable & (other * sign[..., None] > 0)
        between &= np.abs(other) < np.abs(turn)[..., None]
        sign = np.where(between.any(axis=-1), -sign, sign)
        return np.where((side != 0) & (np.abs(turn) > self.SHORT_TURN), side, sign)

    def _clear_of(
        self,
        others: FloatArray,
        berth: FloatArray,
        ring: FloatArray,
        heading: FloatArray,
        relative: FloatArray,
        side: FloatArray,
    ) -> FloatArray:
        """Turn headings (n, arms, 2) as far as the hand behind the cube would touch another.

        A hand that pushes beside another cube goes on straight until the direct way is free.

        :param others: (n, arms, k, 2) from the own cube to others, metres.
        :param berth: (n, arms, k) rings of others, metres.
        :param ring: (n, arms, 1) rings of the own cubes, metres.
        :param heading: the direct ones.
        :param relative: (n, arms, 2) from the own cube to the hand, metres.
        :param side: see :meth:`waypoint`.
        """
        free, direct, pushing = heading, heading, -unit(relative)
        own, ring = np.arctan2(relative[..., 1], relative[..., 0]), ring[..., 0]
        goes_on = (length(relative) < ring + 0.01) & (dot(pushing, direct) > 0.1)
        for other in range(others.shape[-2]):
            gap, apart = others[..., other, :], berth[..., other]
            free = rotated(free, self._lack(gap, free, own, ring, apart - self.BESIDE, side))
            goes_on &= self._lack(gap, pushing, own, ring, apart - self.GOES_ON, side) == 0
        blocked = dot(free, direct) < 1 - 1e-6
        return np.where((blocked & goes_on)[..., None], pushing, free)

    def _lack(
        self,
        gap: FloatArray,
        heading: FloatArray,
        own: FloatArray,
        ring: FloatArray,
        apart: FloatArray,
        side: FloatArray,
    ) -> FloatArray:
        """Return by how much to turn so that the hand is ``apart`` from a cube at ``gap``, rad.

        Of the two ways to turn, that which is nearer to the heading and to the hand's bearing
        ``own`` from the own cube.
        """
        distance = np.maximum(length(gap), 1e-6)
        cosine = (distance**2 + ring**2 - apart**2) / (2 * distance * ring)
        least = np.arccos(np.clip(cosine, -1.0, 1.0))
        bearing = np.arctan2(gap[..., 1], gap[..., 0])
        off = wrapped(np.arctan2(-heading[..., 1], -heading[..., 0]) - bearing)
        hand = wrapped(own - bearing)
        left, right = (
            np.abs(way - off) + self.NEARER * np.abs(wrapped(way - hand)) for way in (least, -least)
        )
        left = left - self.PREFER * side
        return np.where(np.abs(off) >= least, 0.0, np.where(left <= right, least, -least) - off)

    def _trail(
        self, cube: FloatArray, direction: FloatArray, size: FloatArray, hand: FloatArray
    ) -> FloatArray:
        """What is added to the ring in ``direction`` from the cube, (n, arms), metres.

        :param cube: (n, arms, 2) base frames, metres.
        :param direction: (n, arms, 2) unit vectors.
        :param size: (n, arms) edges, metres.
        :param hand: (n, arms) distances of the hands from their bases, metres.
        """
        leans = np.maximum(self.trail, self.lead * (hand - self.upright_at))
        far = np.maximum(dot(unit(cube), direction), 0.0)
        return np.where(self._meets_wrist(size), leans, self.trail) * far

    def _inward(self, cube: FloatArray, heading: FloatArray) -> FloatArray:
        """Turn headings (n, arms, 2) towards the base, at most until they point there.

        :param cube: (n, arms, 2) base frames, metres.
        :param heading: the direct ones.
        """
        angle = np.arctan2(-cube[..., 1], -cube[..., 0])
        off = wrapped(angle - np.arctan2(heading[..., 1], heading[..., 0]))
        return rotated(heading, np.clip(off, -self.INWARD, self.INWARD))

    def _meets_wrist(self, size: FloatArray) -> NDArray[np.bool_]:
        """Whether cubes of edges ``size`` are so high that a pitched hand's wrist meets them."""
        return (size > BELOW_WRIST) & (self.trail > 0)

    def _attainable(self, cube: FloatArray, size: FloatArray, heading: FloatArray) -> FloatArray:
        """Turn headings (n, arms, 2) as little as lets a pitched hand get behind a high cube.

        Behind a cube that is far from the base the hand would be out of reach.

        :param cube: (n, arms, 2) base frames, metres.
        :param size: (n, arms) edges, metres.
        :param heading: the direct ones.
        """
        high = self._meets_wrist(size)
        if not high.any():
            return heading
        inward = np.arctan2(-cube[..., 1], -cube[..., 0])
        angle = wrapped(np.arctan2(heading[..., 1], heading[..., 0]) - inward)
        turns = np.linspace(0.0, np.pi / 2, 19)
        least = turns[np.argmax(self._away(cube, size, turns) < self.REACH, axis=-1)]
        turned = inward + np.where(angle < 0, -1.0, 1.0) * np.maximum(np.abs(angle), least)
        out_of_reach = high & (np.abs(angle) < least)
        direction = np.stack([np.cos(turned), np.sin(turned)], axis=-1)
        return np.where(out_of_reach[..., None], direction, heading)

    def _away(self, cube: FloatArray, size: FloatArray, turns: FloatArray) -> FloatArray:
        """Distances (n, arms, k) from their bases of hands that push at angles from inward, metres.

        :param cube: (n, arms, 2) base frames, metres.
        :param size: (n, arms) edges, metres.
        :param turns: (k,) angles, radians.
        """
        cube, size = np.stack([length(cube), 0 * size], axis=-1)[..., None, :], size[..., None]
        direction = np.stack([np.cos(turns), np.sin(turns)], axis=-1)
        hand = length(cube)
        for _ in range(3):
            behind = self.touch(size) + self._trail(cube, direction, size, hand)
            hand = length(cube + behind[..., None] * direction)
        return hand

    def actions(
        self, view: ArmView, side: FloatArray | None = None, others: FloatArray | None = None
    ) -> FloatArray:
        """Return actions (n, arms, 3) in [-1, 1] of arms that ignore one another's hands.

        :param view: what the arms see.
        :param side: see :meth:`waypoint`; the shorter ways by default.
        :param others: see :meth:`waypoint`; none by default.
        """
        side = np.zeros(view.tool.shape[:2]) if side is None else side
        others = view.tool[..., None, :][..., :0, :] if others is None else others
        point = self.waypoint(view, side, others)
        move = shortened(point - view.tool[..., :2], self.step) / self.step
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
            cubes = self._pushed(part + base, actions[..., :2], cubes, view.object_size)
        for arm in range(tool.shape[1] - 1):
            gap = cubes[:, arm + 1] - cubes[:, arm]
            distance = length(gap)[:, None]
            least = 1.1 * view.object_size[:, arm : arm + 2].mean(axis=1)[:, None]
            apart = gap * np.maximum(least / np.maximum(distance, 1e-6) - 1, 0) / 2
            cubes[:, arm] -= apart
            cubes[:, arm + 1] += apart
        moved = np.concatenate([cubes - base, view.object[..., 2:]], axis=-1)
        return replace(view, tool=tool, object=moved, object_velocity=0 * view.object_velocity)

    def _hand(self, tool: FloatArray) -> list[FloatArray]:
        """Centres of the discs that a hand consists of, (n, arms, 2) each, metres."""
        return [tool] if self.trail == 0 else [tool, tool - WRIST * unit(tool)]

    def _pushed(
        self, hand: FloatArray, motion: FloatArray, cubes: FloatArray, size: FloatArray
    ) -> FloatArray:
        """Cubes (n, arms, 2) moved out of the discs ``hand``, dragged along by their motion."""
        touch = self.touch(size)
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
    robot = settings.robot
    skill = SKILLS.get(robot.name, PushSkill()).fitted(settings)
    if robot.wrist_lead > 0:
        skill = replace(skill, upright_at=robot.upright_at, lead=robot.wrist_lead)
    varied = settings.randomization.distribution_of("object_friction")
    least = task.object_friction if varied is None else varied.ends[0]
    skill = replace(skill, gentle=least < skill.SLIPPERY)
    return alone_or_coordinated(task, settings, skill, JACO_CLOSED, coordinated, free_arm)
