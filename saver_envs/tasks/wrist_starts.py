"""Draws a person on the bench, targets beside the hips, and hands beside the wrists."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.patient import People
from saver_envs.person_scene import HIPS, PersonAddresses
from saver_envs.reachability import ReachabilityMap
from saver_envs.scenes import Scene
from saver_envs.tasks.push import PUSH_HEIGHT
from saver_envs.tasks.regions import Regions
from saver_envs.tasks.sampling import HAND_TO_OBJECT, Start
from saver_envs.tasks.wrist_push import STANDOFF

FloatArray = NDArray[np.float64]

#: Distance of a wrist to its target (m), and where the middle between the hips lies (SPEC 5.6).
WRIST_TO_TARGET: Final = (0.10, 0.25)
HIPS_SPREAD: Final = (0.05, 0.03)
#: The person lies along the stretcher but for this angle (rad), ours.
YAW: Final = 0.05
#: A wrist starts away from the trunk, within this angle of straight outwards (rad), ours.
OUTWARDS: Final = np.radians(60.0)
#: Wrists lie no nearer to the line of the bases than this, and no farther from their base (m).
WRIST_LEAST_X: Final = 0.28
#: A hand starts on the wrist's far side, within this angle of the way from target to wrist (rad).
BEHIND: Final = np.radians(100.0)
#: A hand needs room behind the wrist: so far from its centre (m).
ROOM_BEHIND: Final = 0.07
#: Friction of the limbs, and the factor of the friction and the damping in their joints.
FRICTION: Final = (0.25, 0.6)
STIFFNESS: Final = (0.5, 2.0)
_BLOCK: Final = 64
_MOST_PEOPLE: Final = 200


@dataclass(frozen=True)
class WristStart(Start):
    """A start with a person.

    :param people: who, one row.
    """

    people: People


class WristStartSampler:
    """Draws starts for the bench with a person.

    :param scene: the bench.
    :param regions: gives the workspace of hands and the reach.
    :param reachability: the robot's map.
    """

    def __init__(self, scene: Scene, regions: Regions, reachability: ReachabilityMap) -> None:
        assert scene.person is not None
        self._person: PersonAddresses = scene.person
        self._base = scene.base_position
        self._regions = regions
        self._reachability = reachability

    def sample(self, generator: np.random.Generator) -> WristStart:
        """Draw a start; contacts are not looked at.

        :param generator: the episode's source of randomness.
        :return: the start.
        :raises RuntimeError: when no start is found, which no combination of options leads to.
        """
        for _ in range(_MOST_PEOPLE):
            body = int(generator.integers(len(self._person.arms)))
            hips = np.array(HIPS[:2]) + generator.uniform(-1, 1, 2) * HIPS_SPREAD
            yaw = float(generator.uniform(-YAW, YAW))
            friction = float(generator.uniform(*FRICTION))
            stiffness = float(np.exp(generator.uniform(*np.log(STIFFNESS))))
            arms = [self._arm(generator, body, hips, yaw, arm) for arm in range(2)]
            found = [one for one in arms if one is not None]
            if len(found) == 2:
                wrist, target, hand, shoulder, elbow = (
                    np.stack(part) for part in zip(*found, strict=True)
                )
                people = People(
                    body=np.array([body]),
                    hips=hips[None],
                    yaw=np.array([yaw]),
                    shoulder=shoulder[None],
                    elbow=elbow[None],
                    friction=np.array([friction]),
                    stiffness=np.array([stiffness]),
                )
                return WristStart(hand, wrist, target, people)
        raise RuntimeError(f"none of {_MOST_PEOPLE} people has both wrists within reach")

    def _arm(
        self, generator: np.random.Generator, body: int, hips: FloatArray, yaw: float, index: int
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray] | None:
        """Draw one arm: wrist, target and hand in the base frame, shoulder and elbow angles."""
        arm = self._person.arms[body][index]
        target = arm.hip + np.array([0.0, arm.sideways * STANDOFF, 0.0])
        target[2] = arm.wrist_height
        angle = generator.uniform(-OUTWARDS, OUTWARDS, _BLOCK)
        distance = generator.uniform(*WRIST_TO_TARGET, _BLOCK)
        way = np.stack([np.sin(angle), arm.sideways * np.cos(angle), np.zeros(_BLOCK)], axis=-1)
        wrist = target + distance[:, None] * way
        elbow = arm.elbow_at(wrist, generator.random(_BLOCK) < 0.5)
        side = generator.uniform(-BEHIND, BEHIND, _BLOCK)
        apart = generator.uniform(*HAND_TO_OBJECT, _BLOCK)
        heading = angle + side
        aside = np.stack([np.sin(heading), arm.sideways * np.cos(heading)], axis=-1)
        hand = wrist.copy()
        hand[:, :2] += np.sqrt(apart**2 - (PUSH_HEIGHT - arm.wrist_height) ** 2)[:, None] * aside
        hand[:, 2] = PUSH_HEIGHT
        behind = wrist + ROOM_BEHIND * way
        behind[:, 2] = PUSH_HEIGHT
        places = [self._to_base(points, hips, yaw, index) for points in (wrist, hand, behind)]
        valid = np.isfinite(elbow[:, 0]) & (places[0][:, 0] >= WRIST_LEAST_X)
        valid &= np.hypot(places[0][:, 0], places[0][:, 1]) <= self._regions.reach
        for points in places[1:]:
            valid &= self._hand_can_be_at(points, index)
        chosen = np.flatnonzero(valid)
        if not chosen.size:
            return None
        first = chosen[0]
        rotation, bend = arm.joints(elbow[first], wrist[first])
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, rotation.reshape(9))
        goal = self._to_base(target[None], hips, yaw, index)[0]
        return places[0][first], goal, places[1][first], quaternion, np.asarray(bend)

    def _to_base(self, points: FloatArray, hips: FloatArray, yaw: float, arm: int) -> FloatArray:
        """Turn points (k, 3) of the manikin's frame into ones in the base frame of ``arm``."""
        cosine, sine = np.cos(yaw), np.sin(yaw)
        x, y = points[:, 0], points[:, 1]
        turned = np.stack([cosine * x - sine * y, sine * x + cosine * y, points[:, 2]], axis=-1)
        turned[:, :2] += hips
        moved: FloatArray = turned - self._base[arm]
        return moved

    def _hand_can_be_at(self, points: FloatArray, arm: int) -> NDArray[np.bool_]:
        every = np.repeat(points[:, None], len(self._base), axis=1)
        inside = self._regions.workspace.contains(every)[:, arm]
        reached: NDArray[np.bool_] = self._reachability.reachable(points)
        return inside & reached
