"""Arm straighten: two arms lay the arms of a limp person straight at the sides of the hips."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.control import Workspace, length
from saver_envs.people.bed import Bed
from saver_envs.people.bench import SIDE_OF_ARM
from saver_envs.people.contact_forces import FORCE_COSTS, TORQUE_COSTS
from saver_envs.people.limp_arms import ARM_JOINTS, LimpArms, add_arm_sensors
from saver_envs.people.lying import LyingPosture, LyingWorld
from saver_envs.people.lying_starts import drawn_supine
from saver_envs.people.manikin import SIDES
from saver_envs.robots.description import Fingers
from saver_envs.scenes import BEDSIDE_SPACING, Arms, Bases, Scene, add_target
from saver_envs.simulation import ArmState, Simulation
from saver_envs.tasks.arm_and_object import HAND_PARTS, OBJECT_PARTS, hand_parts, object_parts
from saver_envs.tasks.arm_straighten_starts import NEEDED, PAIRS, kinds_of, stays, wrist_target
from saver_envs.tasks.arm_straighten_starts import start_text as own_start_text
from saver_envs.tasks.care import CareTask, cost_text, start_text
from saver_envs.tasks.care_starts import CareStart, posed_people
from saver_envs.tasks.contract import Bools, FloatArray, Memory, Seen, TaskPage
from saver_envs.tasks.layout import Part
from saver_envs.validation import require
from saver_envs.world import draw_box

#: Greatest bend of an elbow of a straight arm (rad).
STRAIGHT: Final = math.radians(25.0)
#: What a radian of an elbow's bend weighs in the dense reward (m).
_BEND_WEIGHT: Final = 0.1
#: Where a hand starts, in the frame of its base (m).
HAND_LOWER, HAND_UPPER = np.array([0.34, -0.06, 0.27]), np.array([0.48, 0.06, 0.33])
#: Set-points, in the frames of the bases (m): up to the fingertips on the bed, and over the person.
_LOWER, _UPPER = (0.05, -0.50, -0.085), (0.66, 0.50, 0.40)
#: Colour of what the bases stand on.
_STEEL: Final = (0.55, 0.57, 0.60)
_WRIST: Final = OBJECT_PARTS[0]
_BEND: Final = Part("elbow bend", 1, "rad")
_JOINTS: Final = tuple(Part(f"{name} position", 3, "m") for name in ARM_JOINTS[:2])


@dataclass(frozen=True)
class StraightenStart(CareStart):
    """A start of one episode.

    :param target: (arms, 3) where the wrists are to be, in the base frames, metres.
    """

    target: NDArray[np.float64]


@dataclass(frozen=True)
class ArmStraighten(CareTask):
    """Lay the arms of a person on the back straight at the sides of the hips.

    Arm 0 handles the person's right arm, arm 1 the left one. They stand at the head end, on either
    side of a bed of 1.2 m, 0.1 m above it.
    """

    name: ClassVar[str] = "arm straighten"
    fingers: ClassVar[Fingers] = Fingers.ACTUATED
    horizon: ClassVar[int] = 350
    rated_horizon: ClassVar[int] = 700
    summed: ClassVar[tuple[str, ...]] = (*FORCE_COSTS, *TORQUE_COSTS)
    hard: ClassVar[tuple[str, ...]] = (*FORCE_COSTS, *TORQUE_COSTS)
    expert: ClassVar[str | None] = "saver_envs.experts.arm_straighten:expert"
    bed: ClassVar[Bed] = Bed(centre=(0.52, 0.0, -0.10), width=1.2, thickness=0.35)
    table_depth: ClassVar[tuple[float, float]] = (-0.65, 1.70)
    table_height = -0.45  # on which the bed stands
    # All but the tallest: where his arm overhangs, the hand sinks and catches at the bed's edge.
    people: ClassVar[tuple[int, ...]] = (0, 1, 3, 4, 5, 6, 7)
    postures: ClassVar[int] = 2 * PAIRS
    sides: ClassVar[tuple[str, str]] = SIDE_OF_ARM
    joint_parts: ClassVar[Mapping[str, tuple[str, ...]]] = {
        _WRIST.name: ("wrist",),
        **{f"{name} position": (name,) for name in ARM_JOINTS[:2]},
        _BEND.name: ARM_JOINTS,
    }
    handles: ClassVar[tuple[str, ...]] = ("arms",)

    def __post_init__(self) -> None:
        super().__post_init__()
        require("n_arms", self.n_arms, self.n_arms == 2, "exactly 2, one for each arm")

    @property
    def bases(self) -> Bases:
        """How the arms' bases stand."""
        return "bedside"

    @property
    def observation(self) -> tuple[Part, ...]:
        """Each arm's hand, and the person's arm at its side; the object is the wrist."""
        return (*HAND_PARTS, *OBJECT_PARTS, *_JOINTS, _BEND)

    @property
    def goal(self) -> tuple[Part, ...]:
        """Where the wrist is, and how bent the elbow is."""
        return _WRIST, _BEND

    # ---------------------------------------------------------------- the scene

    def build(self, spec: mujoco.MjSpec, arms: Arms, variant: int, decorated: bool) -> None:
        """Add bed and person, what measures them, targets, and what the arms stand on."""
        super().build(spec, arms, variant, decorated)
        add_arm_sensors(spec)
        for index in range(arms.n):
            add_target(spec, index, 0.03, (0.5, 0.1 * index, 0.0))
        if decorated:
            self._add_stands(spec)

    def _add_stands(self, spec: mujoco.MjSpec) -> None:
        """Draw a post beside the bed for each arm, with a plate above the bed, under its base."""
        post, inner = self.bed.width / 2 + 0.07, BEDSIDE_SPACING / 2 - 0.06
        middle, half = (post + inner) / 2, (post - inner) / 2 + 0.03
        height = -self.table_height / 2
        for side in (-1, 1):
            draw_box(spec.worldbody, (0.0, side * middle, -0.011), (0.06, half, 0.01), _STEEL)
            draw_box(spec.worldbody, (0.0, side * post, -height), (0.03, 0.03, height), _STEEL)

    def workspace(self, arms: Arms) -> Workspace:
        """Return where set-points may be."""
        lower, upper = (np.tile(one, (arms.n, 1)) for one in (_LOWER, _UPPER))
        return Workspace(lower, upper)

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
        points = {name: data.site(f"joint_{name}").xpos for name in NEEDED}
        radii = [float(model.geom(f"{side}_forearm_0").size[0]) for side in SIDE_OF_ARM]
        targets = [
            wrist_target(points, side, self.bed, radius)
            for side, radius in zip(SIDE_OF_ARM, radii, strict=True)
        ]
        hand = generator.uniform(HAND_LOWER, HAND_UPPER, (2, 3))
        return StraightenStart(hand, target=scene.to_bases(np.stack(targets)), **person)

    def goal_from(
        self, joints: Mapping[str, NDArray[np.float64]], scene: Scene
    ) -> NDArray[np.float64]:
        """Return where wrists are to be, and straight elbows; see the base class."""
        targets = [
            [
                wrist_target({name: joints[name][row] for name in NEEDED}, side, self.bed)
                for side in SIDE_OF_ARM
            ]
            for row in range(len(joints[NEEDED[0]]))
        ]
        return self._goal(scene.to_bases(np.array(targets)))

    def observe(self, simulation: Simulation, memory: Memory, arms: ArmState) -> Seen:
        """Return hands, and shoulders, elbows and wrists of the person."""
        limbs = simulation.keep(LimpArms)
        seen = hand_parts(simulation, arms) | object_parts(arms, limbs.wrists())
        places = {f"{name} position": limbs.places(name) for name in ARM_JOINTS[:2]}
        return seen | places | {_BEND.name: limbs.bends()}

    def achieved(self, simulation: Simulation, memory: Memory, seen: Seen) -> NDArray[np.float64]:
        """Return wrists, each in its arm's base frame, metres, and bends, radians."""
        parts = [seen[_WRIST.name], seen[_BEND.name]]
        return np.concatenate(parts, axis=-1).reshape(simulation.n, -1)

    def desired(self, starts: Sequence[StraightenStart]) -> NDArray[np.float64]:
        """Return where the wrists are to be; elbows are to be straight."""
        return self._goal(np.stack([start.target for start in starts]))

    @staticmethod
    def _goal(targets: FloatArray) -> NDArray[np.float64]:
        """Return goals (k, goal size) of wrists (k, arms, 3) with straight elbows."""
        straight = np.zeros((*targets.shape[:-1], 1))
        return np.concatenate([targets, straight], axis=-1).reshape(len(targets), -1)

    # ---------------------------------------------------------------- reward

    def distances(self, achieved: FloatArray, desired: FloatArray) -> FloatArray:
        """Return each wrist's distance to its target (..., arms), metres."""
        return length(self.goal_layout.get(achieved - desired, _WRIST.name))

    def reward_and_reached(
        self, achieved: FloatArray, desired: FloatArray
    ) -> tuple[NDArray[np.float32], Bools]:
        """Return rewards and where the goal is reached; see the base class."""
        distances = self.distances(achieved, desired)
        bends = np.abs(self.goal_layout.get(achieved - desired, _BEND.name)[..., 0])
        laid = (distances <= self.success_threshold) & (bends <= STRAIGHT)
        reached: Bools = np.logical_and.reduce(laid, axis=-1)
        if self.reward_type == "sparse":
            return reached.astype(np.float32) - np.float32(1), reached
        return -(distances + _BEND_WEIGHT * bends).sum(axis=-1).astype(np.float32), reached

    # ---------------------------------------------------------------- pictures and the page

    def targets(self, scene: Scene, goal: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where the wrists are to be (n, arms, 3), world frame."""
        return scene.to_world(self.goal_layout.get(goal, _WRIST.name))

    def page(self, scene: Scene) -> TaskPage:
        """Return the text of the page."""
        bend = f"{math.degrees(STRAIGHT):.0f} degrees"
        return TaskPage(
            succeeds=(
                f"each wrist is within {100 * self.success_threshold:g} cm of its target, each "
                f"elbow is bent by at most {bend}, and no part of the person was ever pressed, "
                "and no joint ever pushed against the end of its range, beyond its limit"
            ),
            start=(*start_text(len(self.people)), *own_start_text()),
            reward="0 where both wrists are at their targets and both elbows straight, else -1.",
            dense=(
                "minus the sum of the wrists' distances to their targets, in metres, and of a "
                f"{1 / _BEND_WEIGHT:.0f}th of the elbows' bends, in radians."
            ),
            goal={
                _WRIST.name: "centre of the wrist (achieved), its target (desired)",
                _BEND.name: "angle of the elbow (achieved), 0 (desired)",
            },
            costs=cost_text(),
            facts=(("object", "the person's forearm; its position is that of the wrist"),),
            readings=(
                "`info` also has `force_<part>` (N) and `torque_<joint>` (N m), the greatest of "
                "four samples a step; [A limp person](../limp-person.md) explains them."
            ),
        )
