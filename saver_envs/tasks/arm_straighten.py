"""Arm straighten: two arms lay the arms of a limp person straight at the sides of the hips."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from saver_envs.people.bed import Bed
from saver_envs.people.limp_limbs import LimpArms, LimpLimbs
from saver_envs.people.lying import LyingPosture, LyingWorld
from saver_envs.people.lying_starts import drawn_supine
from saver_envs.people.manikin import SIDES
from saver_envs.robots.description import Fingers
from saver_envs.scenes import Bases, Scene
from saver_envs.tasks.arm_straighten_starts import FOREARM, PAIRS, kinds_of, stays, wrist_target
from saver_envs.tasks.arm_straighten_starts import start_text as own_start_text
from saver_envs.tasks.care import cost_text, start_text
from saver_envs.tasks.care_starts import posed_people
from saver_envs.tasks.contract import TaskPage
from saver_envs.tasks.straighten import READINGS, StraightenStart, StraightenTask, joint_places

#: Greatest bend of an elbow of a straight arm (rad).
STRAIGHT: Final = math.radians(25.0)
#: Where a hand starts, in the frame of its base (m).
HAND_LOWER, HAND_UPPER = np.array([0.34, -0.06, 0.27]), np.array([0.48, 0.06, 0.33])


@dataclass(frozen=True)
class ArmStraighten(StraightenTask):
    """Lay the arms of a person on the back straight at the sides of the hips.

    Arm 0 handles the person's right arm, arm 1 the left one. They stand at the head end, on either
    side of a bed of 1.2 m, 0.1 m above it.
    """

    name: ClassVar[str] = "arm straighten"
    fingers: ClassVar[Fingers] = Fingers.ACTUATED
    horizon: ClassVar[int] = 350
    rated_horizon: ClassVar[int] = 700
    limbs: ClassVar[type[LimpLimbs]] = LimpArms
    straight: ClassVar[float] = STRAIGHT
    # Up to the fingertips on the bed, and over the person.
    lower: ClassVar[tuple[float, float, float]] = (0.05, -0.50, -0.085)
    upper: ClassVar[tuple[float, float, float]] = (0.66, 0.50, 0.40)
    posts: ClassVar[float] = 0.67
    expert: ClassVar[str | None] = "saver_envs.experts.arm_straighten:expert"
    bed: ClassVar[Bed] = Bed(centre=(0.52, 0.0, -0.10), width=1.2, thickness=0.35)
    table_depth: ClassVar[tuple[float, float]] = (-0.65, 1.70)
    # All but the tallest: where his arm overhangs, the hand sinks and catches at the bed's edge.
    people: ClassVar[tuple[int, ...]] = (0, 1, 3, 4, 5, 6, 7)
    postures: ClassVar[int] = 2 * PAIRS
    handles: ClassVar[tuple[str, ...]] = ("arms",)

    @property
    def bases(self) -> Bases:
        """How the arms' bases stand."""
        return "bedside"

    # ---------------------------------------------------------------- episodes

    def posture(self, index: int, generator: np.random.Generator) -> LyingPosture:
        """Draw a posture; every pair of kinds of start has its turn."""
        return drawn_supine(generator, arms=kinds_of(index))

    def keeps(self, world: LyingWorld, index: int) -> bool:
        """Return whether both arms stayed as they were laid."""
        pairs = zip(SIDES, kinds_of(index), strict=True)
        return all(stays(world, self.bed, side, kind) for side, kind in pairs)

    def sample(self, generator: np.random.Generator, scene: Scene) -> StraightenStart:
        """Draw a person, and hands above the person's arms."""
        person = self.drawn_person(generator)
        data = posed_people(scene).posed(person["who"], person["pose"])
        model = scene.models[person["who"]]
        radii = [float(model.geom(f"{side}_forearm_0").size[0]) for side in self.limbs.sides]
        targets = self.targets_from(joint_places(data, self.limbs), radii)
        hand = generator.uniform(HAND_LOWER, HAND_UPPER, (2, 3))
        return StraightenStart(hand, target=scene.to_bases(targets), **person)

    def targets_from(
        self,
        joints: Mapping[str, NDArray[np.float64]],
        radii: Sequence[float] = (FOREARM, FOREARM),
    ) -> NDArray[np.float64]:
        """Return where wrists are to be; see the base class.

        :param joints: as there.
        :param radii: of the forearms, metres.
        """
        sides = zip(self.limbs.sides, radii, strict=True)
        return np.stack([wrist_target(joints, side, self.bed, radius) for side, radius in sides])

    # ---------------------------------------------------------------- pictures and the page

    def page(self, scene: Scene) -> TaskPage:
        """Return the text of the page."""
        return TaskPage(
            succeeds=self.success_text(),
            start=(*start_text(len(self.people), self.ranges), *own_start_text()),
            reward="0 where both wrists are at their targets and both elbows straight, else -1.",
            dense=self.dense_text(),
            goal=self.goal_text(),
            costs=cost_text(),
            facts=(("object", "the person's forearm; its position is that of the wrist"),),
            readings=READINGS,
        )
