"""Draws a person on the bench, targets beside the hips, and hands beside the wrists."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.people.bench import HIPS, person_addresses
from saver_envs.people.bodies import PersonArm
from saver_envs.people.patient import People, turned
from saver_envs.reachability import ReachabilityMap
from saver_envs.scenes import Scene
from saver_envs.tasks.contract import NoStart, Start
from saver_envs.tasks.push import PUSH_HEIGHT
from saver_envs.tasks.regions import Regions
from saver_envs.tasks.sampling import HAND_TO_OBJECT, FloatArray, distance_to_segment

#: Lateral distance of a wrist's target from its hip joint (m): the arms stop that far from the
#: body, so as not to squeeze it (SPEC 5.5).
STANDOFF: Final = 0.15
#: Distance of a wrist to its target (m), and where the middle between the hips lies (SPEC 5.6).
WRIST_TO_TARGET: Final = (0.10, 0.25)
HIPS_SPREAD: Final = (0.05, 0.03)
#: Largest angle between the person and the stretcher (rad), ours.
YAW: Final = 0.05
#: A wrist starts away from the trunk, within this angle of straight outwards (rad), ours.
OUTWARDS: Final = np.radians(60.0)
#: Wrists lie no nearer to the line of the bases than this, and no farther from their base (m).
WRIST_LEAST_X: Final = 0.28
#: A hand starts on the wrist's far side, within this angle of the way from target to wrist (rad).
BEHIND: Final = np.radians(70.0)
#: A hand needs room behind the wrist: so far from its centre (m).
ROOM_BEHIND: Final = 0.07
#: The person's arm starts clear of the robots' bases, and a hand clear of the person's (m).
BASE_RADIUS, HAND_RADIUS, CLEARANCE = 0.040, 0.040, 0.010
#: Largest bend of an elbow that points away from the trunk, which the push bends further, and of
#: one that points towards it (rad); ours.
MOST_BENT_OUTWARDS, MOST_BENT = np.radians(35.0), np.radians(60.0)
#: Smallest gap between forearm and trunk (m): at the start, and after swinging the bent arm to the
#: target; that one is slightly negative, because the trunk straightens the arm.
AIR_AT_START, AIR_AT_END = 0.005, -0.010
#: Friction of the limbs, and the factor of the friction and the damping in their joints.
FRICTION: Final = (0.25, 0.6)
STIFFNESS: Final = (0.5, 2.0)
_BLOCK: Final = 64
_MOST_DISTANCES: Final = 12
_MOST_PEOPLE: Final = 200
#: Tries with a person who is given.
_MOST_TRIES: Final = 20


@dataclass(frozen=True)
class WristStart(Start):
    """A start with a person, every point in its arm's base frame, metres.

    :param target: (arms, 3) where the wrists are to lie.
    :param people: who, one row.
    """

    target: FloatArray
    people: People


class WristStartSampler:
    """Draws starts for the bench with a person.

    :param scene: the bench.
    :param regions: gives the workspace of hands and the reach.
    :param reachability: the robot's map.
    """

    def __init__(self, scene: Scene, regions: Regions, reachability: ReachabilityMap) -> None:
        self._arms = person_addresses(scene).arms
        self._base = scene.base_position
        self._regions = regions
        self._reachability = reachability

    def sample(self, generator: np.random.Generator, known: Mapping[str, Any]) -> WristStart:
        """Draw a start; contacts are not looked at.

        :param generator: the episode's source of randomness.
        :param known: ``mass``, ``body``, ``friction``, ``stiffness`` and ``yaw`` of the person, see
            :class:`saver_envs.people.patient.People`, and ``x`` and ``y``, how far the middle
            between the hip joints is from its usual place, metres; what is ``None`` is drawn.
        :return: the start.
        :raises NoStart: when no start is found: a person who is given may be out of reach.
        """
        tries = _MOST_PEOPLE if known["body"] is None else _MOST_TRIES
        for _ in range(tries):
            people = self._someone(generator, known)
            body, hips, yaw = int(people.body[0]), people.hips[0], float(people.yaw[0])
            found: list[tuple[FloatArray, ...]] = []
            for arm in range(2):
                # The person stays the same: if a distance leaves no room, another one is drawn.
                for _ in range(_MOST_DISTANCES):
                    drawn = self._arm(generator, body, hips, yaw, arm)
                    if drawn is not None:
                        found.append(drawn)
                        break
                else:
                    break
            else:
                target, hand, shoulder, elbow = (
                    np.stack(part) for part in zip(*found, strict=True)
                )
                lying = replace(people, shoulder=shoulder[None], elbow=elbow[None])
                return WristStart(hand, target, lying)
        raise NoStart(f"none of {tries} people has both wrists within reach")

    def _someone(self, generator: np.random.Generator, known: Mapping[str, Any]) -> People:
        """Draw what is not known of a person, one row."""
        body = known["body"]
        if body is None:
            body = int(generator.integers(len(self._arms)))
        middle = np.array(HIPS[:2])
        hips = middle + generator.uniform(-1, 1, 2) * HIPS_SPREAD
        drawn = {
            "yaw": generator.uniform(-YAW, YAW),
            "friction": generator.uniform(*FRICTION),
            "stiffness": np.exp(generator.uniform(*np.log(STIFFNESS))),
        }
        person = {name: new if known[name] is None else known[name] for name, new in drawn.items()}
        for axis, name in enumerate("xy"):
            if known[name] is not None:
                hips[axis] = middle[axis] + known[name]
        person |= {"body": body, "hips": hips, "mass": known["mass"]}
        row = {name: np.array([value]) for name, value in person.items()}
        return replace(People.default(1), **row)

    def _arm(
        self, generator: np.random.Generator, body: int, hips: FloatArray, yaw: float, index: int
    ) -> tuple[FloatArray, ...] | None:
        """Draw one arm: target and hand in the base frame, shoulder and elbow angles.

        :return: ``None`` where the distance that is drawn leaves no room.
        """
        distance = float(generator.uniform(*WRIST_TO_TARGET))
        arm = self._arms[body][index]
        drawn = _Proposals(arm, generator, distance)
        wrist, hand, behind = (
            self._to_base(points, hips, yaw, index)
            for points in (drawn.wrist, drawn.hand, drawn.behind)
        )
        base = turned(self._base[[index], :2] - hips, -yaw)
        valid = (wrist[:, 0] >= WRIST_LEAST_X) & _person_at_ease(arm, drawn)
        valid &= _robot_clear(arm, drawn, base)
        valid &= np.hypot(wrist[:, 0], wrist[:, 1]) <= self._regions.reach
        for points in (hand, behind):
            valid &= self._hand_can_be_at(points, index)
        chosen = np.flatnonzero(valid)
        if not chosen.size:
            return None
        first = chosen[0]
        rotation, bend = arm.joints(drawn.elbow[first], drawn.wrist[first])
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, rotation.reshape(9))
        goal = self._to_base(drawn.target[None], hips, yaw, index)[0]
        return goal, hand[first], quaternion, np.asarray(bend)

    def _to_base(self, points: FloatArray, hips: FloatArray, yaw: float, arm: int) -> FloatArray:
        """Transform points (k, 3) from the manikin's frame to the base frame of ``arm``."""
        moved = points.copy()
        moved[:, :2] = turned(points[:, :2], yaw) + hips
        return moved - self._base[arm]

    def _hand_can_be_at(self, points: FloatArray, arm: int) -> NDArray[np.bool_]:
        every = np.repeat(points[:, None], len(self._base), axis=1)
        inside = self._regions.workspace.contains(every)[:, arm]
        reached: NDArray[np.bool_] = self._reachability.reachable(points)
        return inside & reached


class _Proposals:
    """Candidate poses of one arm, with a hand beside its wrist, in the person's frame.

    :param arm: the person's.
    :param generator: source of randomness.
    :param distance: of the wrist from its target, metres.
    """

    def __init__(self, arm: PersonArm, generator: np.random.Generator, distance: float) -> None:
        #: (3,) of the wrist.
        self.target = arm.hip + np.array([0.0, arm.sideways * STANDOFF, 0.0])
        self.target[2] = arm.wrist_height
        angle = generator.uniform(-OUTWARDS, OUTWARDS, _BLOCK)
        way = np.stack([np.sin(angle), arm.sideways * np.cos(angle), np.zeros(_BLOCK)], axis=-1)
        #: (k, 3).
        self.wrist = self.target + distance * way
        #: (k,) whether the elbow points away from the trunk.
        self.outwards = generator.random(_BLOCK) < 0.5
        #: (k, 3); not numbers where the wrist is out of its reach.
        self.elbow = arm.elbow_at(self.wrist, self.outwards)
        heading = angle + generator.uniform(-BEHIND, BEHIND, _BLOCK)
        apart = generator.uniform(*HAND_TO_OBJECT, _BLOCK)
        aside = np.stack([np.sin(heading), arm.sideways * np.cos(heading)], axis=-1)
        run = np.sqrt(apart**2 - (PUSH_HEIGHT - arm.wrist_height) ** 2)
        #: (k, 3) the robot's.
        self.hand = self.wrist.copy()
        self.hand[:, :2] += run[:, None] * aside
        self.hand[:, 2] = PUSH_HEIGHT
        #: (k, 3) where the robot's hand finds room to start pushing.
        self.behind = self.wrist + ROOM_BEHIND * way
        self.behind[:, 2] = PUSH_HEIGHT
        #: (k, 3) end of the person's hand.
        self.fingers = self.wrist + arm.hand_share * (self.wrist - self.elbow)


def _person_at_ease(arm: PersonArm, drawn: _Proposals) -> NDArray[np.bool_]:
    """Return which proposals (k,) have a possible elbow, not too bent and off the trunk."""
    elbow, wrist = drawn.elbow, drawn.wrist
    most_bent = np.where(drawn.outwards, MOST_BENT_OUTWARDS, MOST_BENT)
    valid = np.isfinite(elbow[:, 0]) & (arm.bend(elbow, wrist) <= most_bent)
    # Swung to where the target is, as a push does it, the arm must not squeeze the trunk.
    headings = [np.arctan2(*(point - arm.shoulder).T[[1, 0]]) for point in (drawn.target, wrist)]
    swing = headings[0] - headings[1]
    for turn, air in ((np.zeros(_BLOCK), AIR_AT_START), (swing, AIR_AT_END)):
        valid &= arm.gap_to_trunk(arm.swung(elbow, turn), arm.swung(wrist, turn)) >= air
    return valid


def _robot_clear(arm: PersonArm, drawn: _Proposals, base: FloatArray) -> NDArray[np.bool_]:
    """Return which proposals (k,) keep the arm clear of the robot's base (1, 2) and its hand."""
    elbow, wrist, fingers = drawn.elbow, drawn.wrist, drawn.fingers
    shoulder = np.broadcast_to(arm.shoulder, wrist.shape)
    upper, fore, palm = arm.radius
    valid = np.ones(len(wrist), dtype=bool)
    for point, own, start, end, radius in (
        (base, BASE_RADIUS, shoulder, elbow, upper),
        (base, BASE_RADIUS, elbow, wrist, fore),
        (drawn.hand, HAND_RADIUS, elbow, wrist, fore),
        (drawn.hand, HAND_RADIUS, wrist, fingers, palm),
    ):
        distance = distance_to_segment(point[:, :2], start[:, :2], end[:, :2])
        valid &= distance >= radius + own + CLEARANCE
    return valid


def start_text() -> list[str]:
    """Return what the sampler guarantees, a sentence each."""
    x, y = (f"{100 * one:g} cm" for one in HIPS_SPREAD)
    inwards, outwards = np.degrees(MOST_BENT), np.degrees(MOST_BENT_OUTWARDS)
    return [
        f"The person lies on the back, the head towards -x, turned by up to {YAW:g} rad; the middle"
        f" between the hip joints at (0.35 +- {x}, +- {y}).",
        f"A wrist's target is {100 * STANDOFF:g} cm beside its hip joint, at the height of a wrist "
        "that lies on the stretcher.",
        f"A wrist {100 * WRIST_TO_TARGET[0]:g} to {100 * WRIST_TO_TARGET[1]:g} cm from its target, "
        "on the outer side, within reach of its arm and in the camera's picture.",
        f"Elbows bent by up to {outwards:.0f} degrees where they point outwards and "
        f"{inwards:.0f} where they point inwards, and no forearm so near the trunk that the swing "
        "to the target would squeeze it.",
        f"A hand {100 * HAND_TO_OBJECT[0]:g} to {100 * HAND_TO_OBJECT[1]:g} cm from its wrist, on "
        "the outer side, closed, with room behind the wrist.",
        f"Friction of the person's arms {FRICTION[0]:g} to {FRICTION[1]:g}; friction and damping "
        f"in their joints times {STIFFNESS[0]:g} to {STIFFNESS[1]:g}.",
        "Nothing touches but the person's arms the stretcher.",
    ]
