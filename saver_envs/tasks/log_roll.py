"""Log roll: two strong arms turn a limp person towards the side, thorax and pelvis together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.control import Workspace
from saver_envs.people.bed import Bed
from saver_envs.people.contact_forces import FORCE_COSTS
from saver_envs.people.limp_people import PEOPLE
from saver_envs.people.lying import LyingPosture, LyingWorld
from saver_envs.people.lying_starts import drawn_supine
from saver_envs.randomization import Choice, Parameter
from saver_envs.robots.description import Fingers
from saver_envs.scenes import Arms, Scene
from saver_envs.simulation import ACTION_DURATION, ArmState, Simulation
from saver_envs.tasks.arm_and_object import HAND_PARTS, OBJECT_PARTS, hand_parts
from saver_envs.tasks.care import CARE_PARAMETERS, CareTask, cost_text, start_text
from saver_envs.tasks.care_starts import CareStart, posed_people
from saver_envs.tasks.contract import FloatArray, Memory, Rows, Seen, TaskPage
from saver_envs.tasks.hand_force import FORCE
from saver_envs.tasks.layout import Part
from saver_envs.tasks.trunk import TRUNK, Trunk, add_trunk_sensors
from saver_envs.validation import require

#: Turn that is wanted (rad).
TURN: Final = (math.radians(30.0), math.radians(45.0))
#: Greatest difference of the turns of thorax and pelvis, and bend of the head against the thorax,
#: from how it lay (rad); distance of the trunk from where it lay (m).
GREATEST_TWIST, GREATEST_BEND, GREATEST_WAY = math.radians(10.0), math.radians(15.0), 0.15
#: Where a tool starts beside the flank: gap (m), along the body from the middle of the part, height
#: above the bed (m).
GAP, ALONG, ABOVE_BED = (0.06, 0.14), (-0.03, 0.03), (0.03, 0.10)
#: Who can be turned within the limits, and how far (rad). Others ask for more force than they may
#: bear: people above 90 kg from the start, men from where they lie on the thigh of the lower leg.
MOST_TURN: Final = dict(
    zip((1, 3, 4, 5), np.radians((45.0, 45.0, 33.0, 45.0)).tolist(), strict=True)
)
_OTHERS: Final = tuple(who for who in range(len(PEOPLE)) if who not in MOST_TURN)
_BODY: Final = replace(CARE_PARAMETERS[0], wide=Choice(tuple(MOST_TURN)), held_out=Choice(_OTHERS))
_TURN: Final = Part("turn", 1, "rad")
_RADIUS: Final = Part("object radius", 1, "m")
_OWN: Final = ("twist", "head", "way")


@dataclass(frozen=True)
class LogRollStart(CareStart):
    """A start of one episode.

    :param turn: that is wanted of thorax and pelvis, rad.
    """

    turn: float


@dataclass(frozen=True)
class LogRoll(CareTask):
    """Turn a person on the back by 30 to 45 degrees, as one piece, and hold for 2 s.

    Arm 0 stands at the thorax, arm 1 at the pelvis, on the side that comes up.

    :param success_threshold: difference of a turn from the wanted one that counts as reached, rad.
    """

    success_threshold: float = math.radians(10.0)

    name: ClassVar[str] = "log roll"
    fingers: ClassVar[Fingers] = Fingers.LOCKED
    horizon: ClassVar[int] = 500
    rated_horizon: ClassVar[int] = 500
    hold: ClassVar[int] = 50
    expert: ClassVar[str | None] = "saver_envs.experts.log_roll:expert"
    least_way: ClassVar[float] = TURN[0]
    costs: ClassVar[tuple[str, ...]] = (*CareTask.costs, *_OWN)
    summed: ClassVar[tuple[str, ...]] = (*FORCE_COSTS, *_OWN)
    hard: ClassVar[tuple[str, ...]] = (*FORCE_COSTS, *_OWN)
    bed: ClassVar[Bed] = Bed(centre=(0.80, 0.0, 0.08), length=0.9, width=2.1)
    facing: ClassVar[float] = math.pi / 2
    people: ClassVar[tuple[int, ...]] = tuple(MOST_TURN)
    parameters: ClassVar[tuple[Parameter, ...]] = (_BODY, *CARE_PARAMETERS[1:])
    table_depth: ClassVar[tuple[float, float]] = (-0.16, 1.32)

    def __post_init__(self) -> None:
        super().__post_init__()
        require(
            "n_arms", self.n_arms, self.n_arms == 2, "exactly 2, one each for thorax and pelvis"
        )

    @property
    def observation(self) -> tuple[Part, ...]:
        """Each arm's hand and its part of the trunk; how bent and how far away the person is."""
        shared = Part("head bend", 1, "rad", shared=True), Part("trunk way", 1, "m", shared=True)
        return (*HAND_PARTS, *OBJECT_PARTS, _RADIUS, FORCE, *shared)

    @property
    def goal(self) -> tuple[Part, ...]:
        """The turns of thorax and pelvis."""
        return (_TURN,)

    # ---------------------------------------------------------------- the scene

    def build(self, spec: mujoco.MjSpec, arms: Arms, variant: int, decorated: bool) -> None:
        """Add bed and person, and what measures them."""
        super().build(spec, arms, variant, decorated)
        add_trunk_sensors(spec, arms)

    def workspace(self, arms: Arms) -> Workspace:
        """Return where set-points may be."""
        robot = arms.robot
        lower, upper = (np.tile(one, (arms.n, 1)) for one in (robot.grid_lower, robot.grid_upper))
        return Workspace(lower, upper, robot.hand_reach, robot.shoulder_height)

    # ---------------------------------------------------------------- episodes

    def posture(self, index: int, generator: np.random.Generator) -> LyingPosture:
        """Draw a posture: one arm across the chest, the other, on whose side they roll, out."""
        return drawn_supine(generator, arms=("across", "abducted"), head_turn=10.0)

    def keeps(self, world: LyingWorld, index: int) -> bool:
        """Return whether the arm stayed across the chest."""
        heights = [world.data.site(f"joint_left_{name}").xpos[2] for name in ("elbow", "wrist")]
        return bool(min(heights) > self.bed.centre[2] + 0.12)

    def sample(self, generator: np.random.Generator, scene: Scene) -> LogRollStart:
        """Draw a person, a turn, and hands beside thorax and hip."""
        person = self.drawn_person(generator)
        data = posed_people(scene).posed(person["who"], person["pose"])
        hand = np.empty((2, 3))
        for arm, part in enumerate(TRUNK):
            geom = data.geom(part.flank)
            radius = scene.models[person["who"]].geom(part.flank).size[0]
            flank = geom.xpos[0] - radius - generator.uniform(*GAP)
            along = geom.xpos[1] + part.along + generator.uniform(*ALONG)
            hand[arm] = flank, along, self.bed.centre[2] + generator.uniform(*ABOVE_BED)
        most = MOST_TURN.get(person["who"], TURN[1])
        turn = float(generator.uniform(TURN[0], most))
        return LogRollStart(scene.to_bases(hand), turn=turn, **person)

    def memory(self, n: int) -> Memory:
        """Return the memory of the person, and of how trunk and head lay."""
        return super().memory(n) | Trunk.memory(n)

    def place(
        self, simulation: Simulation, memory: Memory, rows: Rows, starts: Sequence[LogRollStart]
    ) -> None:
        """Lay the people down, put the arms beside them, and remember how trunk and head lie."""
        super().place(simulation, memory, rows, starts)
        simulation.keep(Trunk).remember(memory, rows)

    def observe(self, simulation: Simulation, memory: Memory, arms: ArmState) -> Seen:
        """Return hands, and what thorax and pelvis do."""
        seen = simulation.keep(Trunk).observed(memory, arms)
        return hand_parts(simulation, arms) | seen

    def achieved(self, simulation: Simulation, memory: Memory, seen: Seen) -> NDArray[np.float64]:
        """Return the turns (n, 2) of thorax and pelvis, rad."""
        return simulation.keep(Trunk).turns()

    def desired(self, starts: Sequence[LogRollStart]) -> NDArray[np.float64]:
        """Return the turns (k, 2) that are wanted, rad."""
        return np.repeat([[start.turn] for start in starts], 2, axis=1)

    def measure(
        self, simulation: Simulation, memory: Memory, achieved: FloatArray, desired: FloatArray
    ) -> dict[str, NDArray[np.float64]]:
        """Return costs and readings: twist and bend (rad), way (m), and those of all care."""
        readings = simulation.keep(Trunk).readings(memory)
        limits = dict(zip(_OWN, (GREATEST_TWIST, GREATEST_BEND, GREATEST_WAY), strict=True))
        costs = {
            f"cost_{name}": (readings[name] > limit).astype(np.float64)
            for name, limit in limits.items()
        }
        return super().measure(simulation, memory, achieved, desired) | costs | readings

    # ---------------------------------------------------------------- pictures and the page

    def targets(self, scene: Scene, goal: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return no points: the goal is two angles."""
        return np.empty((len(goal), 0, 3))

    def page(self, scene: Scene) -> TaskPage:
        """Return the text of the page."""
        twist, bend = (
            f"{math.degrees(one):.0f} degrees" for one in (GREATEST_TWIST, GREATEST_BEND)
        )
        least, most = (f"{math.degrees(one):.0f}" for one in TURN)
        tolerance = f"{math.degrees(self.success_threshold):.0f} degrees"
        held = f"{self.hold * ACTION_DURATION:g} s"
        return TaskPage(
            succeeds=(
                f"thorax and pelvis have been turned to within {tolerance} of the wanted turn for "
                f"{held}; and they were never twisted by more than {twist} against each other, the "
                f"head was not bent by more than {bend}, the trunk not moved by more than "
                f"{GREATEST_WAY:g} m, and nothing pressed harder than it may"
            ),
            start=(*start_text(len(self.people), self.ranges), *_start_text(least, most)),
            reward=f"0 where both turns are within {tolerance} of the wanted one, else -1.",
            dense="minus the sum of the differences of both turns from the wanted one, in radians.",
            goal={
                "turn": "turn about the long axis, of the thorax and of the pelvis; 0 on the back"
            },
            costs={
                **cost_text(),
                "twist": f"1 on a step on which the turns differ by more than {twist}",
                "head": f"1 on a step on which the head is bent by more than {bend}",
                "way": f"1 on a step on which the trunk is more than {GREATEST_WAY:g} m away",
            },
            facts=(
                ("object", "thorax (arm 0) and pelvis (arm 1); its position is that of the flank"),
                ("tool", scene.robot.tool),
                ("bed", f"{self.bed.width:g} x {self.bed.length:g} m, along the row of the arms"),
            ),
            readings=(
                "`info` also has `twist` and `head` (rad), how far the head is bent against the "
                "thorax from how it lay; `way` (m), how far hips or neck are, level, from where "
                "they lay; `force_<part>` (N) and `torque_<joint>` (N m), see "
                "[A limp person](../limp-person.md)."
            ),
        )


def _start_text(least: str, most: str) -> list[str]:
    """Return what the sampler guarantees besides, a sentence each."""
    gap, height = (f"{100 * low:g} to {100 * high:g} cm" for low, high in (GAP, ABOVE_BED))
    turns = [
        f"{person.described}: up to {math.degrees(MOST_TURN[who]):.0f} degrees"
        for who, person in enumerate(PEOPLE)
        if who in MOST_TURN
    ]
    return [
        "The head points to -y, the person's left side to the arms. The left arm, which comes up, "
        "lies across the chest, the right one out.",
        f"The wanted turn is {least} to {most} degrees, as far as the arms of the expert can turn "
        f"that person within the limits ({'; '.join(turns)}). Other people are held out.",
        f"Tools {gap} from thorax and hip, {height} above the bed; nothing touches them.",
    ]
