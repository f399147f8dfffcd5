"""Leg straighten: two arms lay the legs of a limp person straight, side by side."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from saver_envs.people.bed import Bed
from saver_envs.people.limp_limbs import LimpLegs, LimpLimbs
from saver_envs.people.limp_people import PEOPLE
from saver_envs.people.lying import LyingPosture, LyingWorld
from saver_envs.people.lying_starts import drawn_supine
from saver_envs.people.manikin import SIDES
from saver_envs.randomization import Choice, Parameter, Uniform
from saver_envs.robots.description import Fingers
from saver_envs.scenes import Scene
from saver_envs.simulation import ArmState, Simulation
from saver_envs.tasks.care import CARE_PARAMETERS, RANGES, cost_text, start_text
from saver_envs.tasks.care_starts import posed_people
from saver_envs.tasks.contract import Memory, Seen, TaskPage
from saver_envs.tasks.layout import Part
from saver_envs.tasks.leg_straighten_starts import PAIRS, ankle_target, kinds_of, stays
from saver_envs.tasks.leg_straighten_starts import start_text as own_start_text
from saver_envs.tasks.straighten import READINGS, StraightenStart, StraightenTask, joint_places

#: Greatest bend of a knee of a straight leg (rad).
STRAIGHT: Final = math.radians(15.0)
#: Where a hand starts, in the frame of its base, the second number outwards (m).
HAND_LOWER, HAND_UPPER = np.array([0.30, -0.02, 0.28]), np.array([0.42, 0.10, 0.34])
#: Who lies there: all but the last of the people.
_PEOPLE: Final = tuple(range(len(PEOPLE) - 1))
_BODY: Final = replace(CARE_PARAMETERS[0], wide=Choice(_PEOPLE))
#: The bed has a slide sheet.
_SHEET: Final = replace(CARE_PARAMETERS[-1], wide=Uniform(0.12, 0.35), held_out=Uniform(0.35, 0.5))
#: What an arm sees of the leg at the other arm.
_OTHER: Final = tuple(Part(f"other {name} position", 3, "m") for name in LimpLegs.joints[1:])


@dataclass(frozen=True)
class LegStraighten(StraightenTask):
    """Lay the legs of a person on the back straight, 20 cm apart.

    Arm 0 handles the person's left leg, arm 1 the right one. They stand at the foot end of a bed
    with a slide sheet, 0.1 m above it.
    """

    name: ClassVar[str] = "leg straighten"
    fingers: ClassVar[Fingers] = Fingers.LOCKED
    horizon: ClassVar[int] = 250
    rated_horizon: ClassVar[int] = 500
    limbs: ClassVar[type[LimpLimbs]] = LimpLegs
    straight: ClassVar[float] = STRAIGHT
    lower: ClassVar[tuple[float, float, float]] = (0.05, -0.50, -0.085)
    upper: ClassVar[tuple[float, float, float]] = (0.68, 0.50, 0.40)
    posts: ClassVar[float] = 0.36
    expert: ClassVar[str | None] = "saver_envs.experts.leg_straighten:expert"
    # Starts are settled where it is most slippery.
    bed: ClassVar[Bed] = Bed(
        centre=(1.15, 0.0, -0.10), length=2.14, width=1.2, thickness=0.35, friction=0.15
    )
    facing: ClassVar[float] = math.pi
    table_depth: ClassVar[tuple[float, float]] = (-0.30, 2.45)
    ranges: ClassVar[Mapping[str, tuple[float, float]]] = {**RANGES, "bed_friction": (0.15, 0.3)}
    handles: ClassVar[tuple[str, ...]] = ("legs",)
    people: ClassVar[tuple[int, ...]] = _PEOPLE
    postures: ClassVar[int] = 4 * len(PAIRS)
    parameters: ClassVar[tuple[Parameter, ...]] = (_BODY, *CARE_PARAMETERS[1:-1], _SHEET)

    @property
    def observation(self) -> tuple[Part, ...]:
        """Each arm's hand, the leg at its side, and where the other one is."""
        return (*super().observation, *_OTHER)

    # ---------------------------------------------------------------- episodes

    def posture(self, index: int, generator: np.random.Generator) -> LyingPosture:
        """Draw a posture; every pair of kinds of start has its turn."""
        return drawn_supine(generator, legs=kinds_of(index))

    def keeps(self, world: LyingWorld, index: int) -> bool:
        """Return whether both legs stayed as they were laid."""
        pairs = zip(SIDES, kinds_of(index), strict=True)
        return all(stays(world, self.bed, side, kind) for side, kind in pairs)

    def sample(self, generator: np.random.Generator, scene: Scene) -> StraightenStart:
        """Draw a person, and hands above the person's feet."""
        person = self.drawn_person(generator)
        data = posed_people(scene).posed(person["who"], person["pose"])
        targets = self.targets_from(joint_places(data, self.limbs))
        hand = generator.uniform(HAND_LOWER, HAND_UPPER, (2, 3))
        hand[0, 1] *= -1
        return StraightenStart(hand, target=scene.to_bases(targets), **person)

    def targets_from(self, joints: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64]:
        """Return where ankles are to be; see the base class."""
        return np.stack([ankle_target(joints, side, self.bed) for side in self.limbs.sides])

    def parts_from(self, joints: Mapping[str, NDArray[np.float64]], scene: Scene) -> Seen:
        """Return also where the leg at the other arm is; see the base class."""
        others = {
            f"other {name} position": scene.to_bases(
                np.stack([joints[f"{side}_{name}"] for side in self.limbs.sides[::-1]], 1)
            )
            for name in self.limbs.joints[1:]
        }
        return super().parts_from(joints, scene) | others

    def observe(self, simulation: Simulation, memory: Memory, arms: ArmState) -> Seen:
        """Return hands, and the joints of the person's legs."""
        limbs = simulation.keep(self.limbs)
        names = self.limbs.joints[1:]
        others = {f"other {name} position": limbs.places(name, other=True) for name in names}
        return super().observe(simulation, memory, arms) | others

    # ---------------------------------------------------------------- pictures and the page

    def page(self, scene: Scene) -> TaskPage:
        """Return the text of the page."""
        return TaskPage(
            succeeds=self.success_text(),
            start=(
                *start_text(len(self.people), self.ranges),
                *own_start_text(),
                f"One of the people of other tasks ({PEOPLE[-1].described}) does not lie there: "
                "her thighs meet before her ankles are at their targets.",
            ),
            reward="0 where both ankles are at their targets and both knees straight, else -1.",
            dense=self.dense_text(),
            goal=self.goal_text(),
            costs=cost_text(),
            facts=(
                ("object", "the person's lower leg; its position is that of the ankle"),
                ("fingers", "closed and locked: legs are only pushed"),
            ),
            readings=READINGS,
        )
