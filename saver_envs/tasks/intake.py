"""Intake: a bed conveys a limp person, feet first, between two rails; two arms keep limbs in."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.control import Workspace
from saver_envs.people.bed import BED_PRIORITY, Bed, add_bed
from saver_envs.people.limp_people import PEOPLE, LimpPeople
from saver_envs.people.lying import LyingPosture, LyingWorld
from saver_envs.people.lying_starts import drawn_supine
from saver_envs.people.manikin import SIDES
from saver_envs.randomization import Choice, Parameter, Uniform
from saver_envs.robots.description import Fingers
from saver_envs.scenes import Arms, Scene, add_contact_sensor
from saver_envs.simulation import ArmState, Simulation
from saver_envs.tasks.arm_and_object import HAND_PARTS, hand_parts
from saver_envs.tasks.care import BED, CARE_PARAMETERS, CareTask, cost_text, start_text
from saver_envs.tasks.care_starts import CareStart
from saver_envs.tasks.contract import FloatArray, Memory, Rows, Seen, TaskPage
from saver_envs.tasks.hand_force import FORCE, HandForces, add_force_sensors
from saver_envs.tasks.layout import Part
from saver_envs.tasks.limbs import LIMB_JOINTS, POSITIONS, VELOCITIES, Limbs, add_limb_sensors
from saver_envs.tasks.regions import HAND_LOWER, HAND_UPPER
from saver_envs.validation import require
from saver_envs.world import TABLE_BIT

#: Way of the person (m), and speeds of the bed of which one is drawn for an episode (m/s).
WAY, SPEED = 1.8, (0.07, 0.10)
#: Distance between the rails, their height above the bed and thickness (m); where they begin, along
#: x; length (m) and angle (rad) of the flares in front of them; their friction. Ours.
GAP, RAIL_HEIGHT, RAIL_THICKNESS = 0.60, 0.12, 0.02
ENTRANCE, FLARE_LENGTH, FLARE_ANGLE, RAIL_FRICTION = 0.05, 0.15, math.radians(22.0), 0.15
#: Where hands start: forward, outwards and up from their bases (m).
HAND_START: Final = ((0.34, 0.38), (0.08, 0.16), (0.30, 0.36))
#: How far outside of the rails' line a wrist lies at least (m).
OUTSIDE: Final = 0.04
#: How far an ankle is from the middle at most (m).
FEET: Final = 0.22
#: Who is held out: the tallest, whose arms reach farther out than hands sweep them in in time, and
#: the broadest, who fills the space between the rails.
_HELD_OUT: Final = (2, 6)
_PEOPLE: Final = tuple(who for who in range(len(PEOPLE)) if who not in _HELD_OUT)
_BODY: Final = replace(CARE_PARAMETERS[0], wide=Choice(_PEOPLE), held_out=Choice(_HELD_OUT))
#: Kinds of starts of the arms of a posture and of its mirror image; legs are straight.
ARM_KINDS: Final = (
    ("apart", "apart"),
    ("apart", "side"),
    ("apart", "apart"),
    ("apart", "chest"),
    ("apart", "bent"),
)
#: Names of the geoms of the rails and their flared ends.
RAILS: Final = ("rail_left", "flare_left", "rail_right", "flare_right")
_INNER: Final = "inner_bed"
_BEHIND: Final = 2.0
#: How far the pelvis has travelled; how far the arm at a side is from the space between the rails.
_GOAL: Final = (Part("travel", 1, "m"), Part("arm outside", 1, "m"))


@dataclass(frozen=True)
class IntakeStart(CareStart):
    """A start of one episode.

    :param speed: of the bed, m/s.
    """

    speed: float


@dataclass(frozen=True)
class Intake(CareTask):
    """A person travels 1.8 m on a moving bed into the robot; limbs must not jam at the rails.

    The arms stand beside the rails. Arm 0 has the person's left side.

    :param bed_speed: speed of the bed, m/s; drawn by default.
    """

    bed_speed: float | None = None

    name: ClassVar[str] = "intake"
    fingers: ClassVar[Fingers] = Fingers.LOCKED
    horizon: ClassVar[int] = 700
    rated_horizon: ClassVar[int] = 700
    least_way: ClassVar[float] = WAY
    pressers: ClassVar[tuple[str, ...]] = RAILS
    people: ClassVar[tuple[int, ...]] = _PEOPLE
    postures: ClassVar[int] = 30
    bed: ClassVar[Bed] = Bed(centre=(1.30, 0.0, 0.08), length=2.5, width=1.5)
    facing: ClassVar[float] = math.pi
    expert: ClassVar[str | None] = "saver_envs.experts.intake:expert"
    table_depth: ClassVar[tuple[float, float]] = (-1.0, 2.7)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        _BODY,
        *CARE_PARAMETERS[1:],
        Parameter(
            *("bed_speed", "m/s", "speed of the bed", None, (0.065, 0.20)),
            wide=Uniform(0.07, 0.12),
            held_out=Uniform(0.12, 0.15),
        ),
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        require("n_arms", self.n_arms, self.n_arms == 2, "exactly 2, one at each rail")

    @property
    def observation(self) -> tuple[Part, ...]:
        """Each arm's hand, what it presses with, and the limbs at its side; the bed's speed."""
        shared = Part("bed speed", 1, "m/s", shared=True), Part("way left", 1, "m", shared=True)
        return (*HAND_PARTS, *POSITIONS, *VELOCITIES, FORCE, *shared)

    @property
    def goal(self) -> tuple[Part, ...]:
        """How far the person has travelled, and how far the arm at a side is still outside."""
        return _GOAL

    @property
    def joint_parts(self) -> Mapping[str, tuple[str, ...]]:
        """Which parts are positions of joints; see the base class."""
        return {f"{joint} position": (joint,) for joint in LIMB_JOINTS}

    # ---------------------------------------------------------------- the scene

    def build(self, spec: mujoco.MjSpec, arms: Arms, variant: int, decorated: bool) -> None:
        """Add bed, rails and person, and what measures them."""
        super().build(spec, arms, variant, decorated)
        begin = self.bed.centre[0] - self.bed.length / 2
        centre = (begin - _BEHIND / 2, 0.0, self.bed.centre[2])
        add_bed(spec, Bed(centre=centre, length=_BEHIND, width=GAP), _INNER)
        for name in (BED, _INNER):  # else the compiled model has no velocities of surfaces
            spec.geom(name).surfacevel[0] = -SPEED[0]
        _add_rails(spec, self.bed.centre[2])
        add_limb_sensors(spec)
        add_force_sensors(spec, arms)
        for index in range(arms.n):
            for name in (_INNER, *RAILS):
                sensor = f"collision_arm{index}_{name}"
                add_contact_sensor(spec, sensor, arms.body(index), mujoco.mjtObj.mjOBJ_GEOM, name)

    def workspace(self, arms: Arms) -> Workspace:
        """Return where set-points may be."""
        lower, upper = (np.tile(one, (arms.n, 1)) for one in (HAND_LOWER, HAND_UPPER))
        robot = arms.robot
        return Workspace(lower, upper, robot.hand_reach, robot.shoulder_height)

    # ---------------------------------------------------------------- episodes

    def posture(self, index: int, generator: np.random.Generator) -> LyingPosture:
        """Draw a posture on the back, every pair of kinds as often as its mirror image."""
        posture = drawn_supine(generator, arms=ARM_KINDS[index % len(ARM_KINDS)])
        return posture if index % 2 else posture.mirrored()

    def keeps(self, world: LyingWorld, index: int) -> bool:
        """Return whether a wrist lies outside of the line of the rails."""
        wrists = [world.data.site(f"joint_{side}_wrist").xpos[1] for side in SIDES]
        return bool(np.abs(wrists).max() > GAP / 2 + OUTSIDE)

    def sample(self, generator: np.random.Generator, scene: Scene) -> IntakeStart:
        """Draw a person, the bed's speed, and hands raised beside the rails."""
        person = self.drawn_person(generator)
        ahead, aside, up = (generator.uniform(*ends, self.n_arms) for ends in HAND_START)
        hand = np.stack([ahead, aside * np.array([-1.0, 1.0]), up], axis=-1)
        drawn = float(generator.uniform(*SPEED))
        speed = drawn if self.bed_speed is None else self.bed_speed
        return IntakeStart(hand, speed=speed, **person)

    def valid(
        self, simulation: Simulation, memory: Memory, rows: Rows, starts: Sequence[Any]
    ) -> NDArray[np.bool_]:
        """Return also whether feet are on their way between the rails."""
        feet = np.abs(simulation.keep(Limbs).ankles()[rows, :, 1]).max(axis=-1)
        return super().valid(simulation, memory, rows, starts) & (feet < FEET)

    def memory(self, n: int) -> Memory:
        """Return the memory of the person, of where the pelvis was, and of the bed's speed."""
        return super().memory(n) | {"began": np.zeros(n), "speed": np.zeros(n)}

    def lay(
        self, simulation: Simulation, memory: Memory, rows: Rows, starts: Sequence[Any]
    ) -> None:
        """Lay the people down, and remember where they were."""
        memory["speed"][rows] = [start.speed for start in starts]
        super().lay(simulation, memory, rows, starts)
        memory["began"][rows] = _pelvis(simulation)[rows]
        self.drive(simulation, memory, rows)

    def _give(self, simulation: Simulation, memory: Memory, rows: Rows) -> None:
        super()._give(simulation, memory, rows)
        inner = simulation.scene.model.geom(_INNER).id
        friction = simulation.per_simulation("geom_friction")
        friction[rows, inner, 0] = memory["bed_friction"][rows]

    def drive(self, simulation: Simulation, memory: Memory, rows: Rows | slice) -> None:
        """Move the bed until the person has travelled the whole way."""
        travelled = memory["began"][rows] - _pelvis(simulation)[rows]
        speed = np.where(travelled < WAY, memory["speed"][rows], 0.0)
        surface = simulation.per_simulation("geom_surfacevel")
        for name in (BED, _INNER):
            surface[rows, simulation.scene.model.geom(name).id, 0] = -speed

    def observe(self, simulation: Simulation, memory: Memory, arms: ArmState) -> Seen:
        """Return hands, limbs, and what the bed does."""
        travelled = memory["began"] - _pelvis(simulation)
        bed = {"bed speed": memory["speed"][:, None], "way left": (WAY - travelled)[:, None]}
        limbs, forces = simulation.keep(Limbs).observed(), simulation.keep(HandForces).observed()
        return hand_parts(simulation, arms) | limbs | forces | bed

    def achieved(self, simulation: Simulation, memory: Memory, seen: Seen) -> NDArray[np.float64]:
        """Return how far the person has travelled and arms are outside, (n, 4), metres."""
        travelled = np.repeat(WAY - seen["way left"], self.n_arms, axis=1)
        outside = _outside(simulation.keep(Limbs).arms())
        return np.stack([travelled, outside], axis=-1).reshape(len(outside), -1)

    def desired(self, starts: Sequence[Any]) -> NDArray[np.float64]:
        """Return how far the person is to travel, and that arms are inside, (k, 4), metres."""
        return np.tile([WAY, 0.0], (len(starts), self.n_arms))

    # ---------------------------------------------------------------- pictures and the page

    def targets(self, scene: Scene, goal: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return no points: the goal is a way."""
        return np.empty((len(goal), 0, 3))

    def page(self, scene: Scene) -> TaskPage:
        """Return the text of the page."""
        low, high = SPEED
        return TaskPage(
            succeeds=(
                f"the person has travelled {WAY:g} m, wrists and elbows are between the rails to "
                f"within {100 * self.success_threshold:g} cm, and no part of the body was ever "
                "pressed beyond its limit"
            ),
            start=(
                *start_text(len(self.people), self.ranges),
                f"One wrist or both are more than {100 * OUTSIDE:g} cm outside of the rails' line.",
                "One arm or both lie apart, abducted by 24 to 38 degrees, the other one else at "
                "the side, bent beside the trunk, or on the chest.",
                f"Legs are straight, ankles at most {100 * FEET:g} cm from the middle.",
                f"The tallest and the broadest person are held out ({_described()}): the one's "
                "arms reach too far out for the hands, the other's fill the space between the "
                "rails.",
                f"The bed moves at {low:g} to {high:g} m/s, slower ones would not fit the horizon, "
                f"and stops after {WAY:g} m.",
                "Hands are raised beside the rails.",
            ),
            reward="0 where the person has travelled the whole way with both arms inside, else -1.",
            dense="minus how far travel and arm are from what is wanted, in metres, of both arms.",
            goal={
                "travel": "how far the pelvis has travelled, the same for both arms",
                "arm outside": (
                    "distance of the wrist or elbow at this side, whichever is farther, from the "
                    "space between the rails"
                ),
            },
            costs={
                **cost_text(),
                "collision": (
                    "1 on a step with contact between arms, or of an arm with the table, the bed "
                    "or a rail"
                ),
            },
            facts=(
                ("rails", f"{GAP:g} m apart, {100 * RAIL_HEIGHT:g} cm high, with flared ends"),
                ("person", "conveyed feet first"),
            ),
            readings="`info` also has forces (N) by part of the body and torques (N m) of joints.",
        )


def _described() -> str:
    """Return who is held out."""
    return "; ".join(PEOPLE[who].described for who in _HELD_OUT)


def _pelvis(simulation: Simulation) -> NDArray[np.float64]:
    """Return where pelvises are along x, (n,), metres."""
    return simulation.qpos[:, simulation.keep(LimpPeople).layout.root_qpos[0]]


def _outside(points: FloatArray) -> FloatArray:
    """Return how far the farthest of points (..., k, 3) is from between the rails, metres."""
    before = np.maximum(points[..., 0] - ENTRANCE, 0.0)
    beside = np.maximum(np.abs(points[..., 1]) - GAP / 2, 0.0)
    farthest: FloatArray = np.hypot(before, beside).max(axis=-1)
    return farthest


def _add_rails(spec: mujoco.MjSpec, height: float) -> None:
    """Add rails and their flared ends on a bed of this height (m)."""
    thick, tall = RAIL_THICKNESS / 2, RAIL_HEIGHT / 2
    ahead, aside = (FLARE_LENGTH / 2 * one(FLARE_ANGLE) for one in (math.cos, math.sin))
    for index, name in enumerate(RAILS):
        flared, sign = index % 2 == 1, 1.0 if index > 1 else -1.0
        length, turn = (FLARE_LENGTH, sign * FLARE_ANGLE) if flared else (_BEHIND, 0.0)
        x = ENTRANCE + (ahead if flared else -_BEHIND / 2)
        y = sign * (GAP / 2 + thick + (aside if flared else 0.0))
        spec.worldbody.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=(x, y, height + tall),
            quat=(math.cos(turn / 2), 0, 0, math.sin(turn / 2)),
            size=(length / 2, thick, tall),
            contype=TABLE_BIT,
            conaffinity=0,
            condim=4,
            priority=BED_PRIORITY,
            friction=(RAIL_FRICTION, 0.01, 0.001),
            rgba=(0.30, 0.33, 0.38, 1),
        )
