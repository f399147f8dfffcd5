"""Care: what the tasks in which a limp person on a bed is handled have in common."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any, ClassVar, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.people.bed import Bed, add_bed
from saver_envs.people.contact_forces import (
    FORCE_COSTS,
    FORCE_LIMITS,
    LASTING,
    NEVER_MORE,
    TORQUE_COSTS,
    TRANSIENT_FACTOR,
    PersonLoads,
    add_load_sensors,
    load_memory,
)
from saver_envs.people.limp_people import LIMP_PERSON_PARAMETERS, PEOPLE, LimpPeople
from saver_envs.people.limp_person import add_limp_person
from saver_envs.people.lying import POSE_SIZE, LyingPosture, LyingWorld
from saver_envs.people.manikin import SIDES
from saver_envs.randomization import Parameter, Uniform
from saver_envs.randomization.parameters import require_allowed
from saver_envs.reachability import reachability_map
from saver_envs.scenes import Arms, Scene, add_collision_counters
from saver_envs.simulation import Resting, Simulation
from saver_envs.tasks.care_starts import moved, settled
from saver_envs.tasks.contract import FloatArray, Memory, Rows, Seen, Task
from saver_envs.validation import require

#: Name of the bed's geom.
BED: Final = "bed"
#: Ranges from which nominal starts are drawn: how far a person lies from the usual place, along x
#: and y (m), and turned (rad); factor of the stiffness of joints; sliding friction of clothes and
#: skin, and of a person and a bed sheet.
RANGES: Final[Mapping[str, tuple[float, float]]] = {
    "person_x": (-0.02, 0.02),
    "person_y": (-0.03, 0.03),
    "person_yaw": (-0.05, 0.05),
    "person_stiffness": (0.8, 1.25),
    "person_friction": (0.35, 0.5),
    "bed_friction": (0.4, 0.6),
}

#: What may differ between people on beds; a task has options of these names.
CARE_PARAMETERS: Final = (
    *LIMP_PERSON_PARAMETERS,
    Parameter(
        *("person_x", "m", "place of the person along x, from the usual one", None, (-0.1, 0.1)),
        wide=Uniform(-0.03, 0.03),
    ),
    Parameter(
        *("person_y", "m", "place of the person along y, from the usual one", None, (-0.1, 0.1)),
        wide=Uniform(-0.05, 0.05),
    ),
    Parameter(
        *("person_yaw", "rad", "turn of the person against the bed", None, (-0.2, 0.2)),
        wide=Uniform(-0.08, 0.08),
    ),
    Parameter(
        *("bed_friction", "", "sliding friction of the person and the bed", None, (0.02, 1.5)),
        wide=Uniform(0.3, 0.7),
        held_out=Uniform(0.7, 0.9),
    ),
)
#: What an episode remembers of a start.
_REMEMBERED: Final = ("who", "stiffness", "friction", "bed_friction")


@dataclass(frozen=True)
class CareTask(Task):
    """Base of tasks with a limp person on a bed.

    A subclass says where bed and person are, :attr:`bed` and :attr:`facing`, and how the person
    lies, :meth:`posture`; ``python tools/settle_starts.py ID`` then settles its starts. Its
    ``sample`` adds hands and a goal to :meth:`drawn_person`. It adds what it measures to
    :meth:`build`, :meth:`memory` and :meth:`measure`.

    :param person_body: which of the persons lies there; drawn by default, as are friction,
        stiffness, place, turn, and the friction of the bed.
    :param person_friction: sliding friction of the person's clothes and skin.
    :param person_stiffness: factor of stiffness and damping of the person's joints.
    :param person_x: place of the person along x, from the usual one, m.
    :param person_y: place of the person along y, from the usual one, m.
    :param person_yaw: turn of the person against the bed, rad.
    :param bed_friction: sliding friction of the person and the bed.
    :param person_pose: (35,) how the person lies, as ``CareTask.pose_of`` returns it; one of the
        settled postures by default.
    """

    person_body: int | None = None
    person_friction: float | None = None
    person_stiffness: float | None = None
    person_x: float | None = None
    person_y: float | None = None
    person_yaw: float | None = None
    bed_friction: float | None = None
    person_pose: tuple[float, ...] | None = None

    #: On which the person lies, on the table.
    bed: ClassVar[Bed]
    #: Turn of the person about the vertical (rad); at 0 the feet point along +x.
    facing: ClassVar[float] = 0.0
    #: Who lies there by default.
    people: ClassVar[tuple[int, ...]] = tuple(range(len(PEOPLE)))
    #: Names of geoms of the world that press on the person, besides the arms.
    pressers: ClassVar[tuple[str, ...]] = ()
    #: From which nominal starts are drawn, as :data:`RANGES`, in the order of drawing.
    ranges: ClassVar[Mapping[str, tuple[float, float]]] = RANGES
    #: How many settled postures there are of every person.
    postures: ClassVar[int] = 32
    #: Fields of a :class:`saver_envs.people.lying.LyingPosture` that starts differ in.
    handles: ClassVar[tuple[str, ...]] = ()

    costs: ClassVar[tuple[str, ...]] = ("collision", *FORCE_COSTS, *TORQUE_COSTS)
    summed: ClassVar[tuple[str, ...]] = FORCE_COSTS
    hard: ClassVar[tuple[str, ...]] = FORCE_COSTS
    variants: ClassVar[int] = len(PEOPLE)
    keeps_peaks: ClassVar[bool] = True
    keeps_to_table: ClassVar[bool] = False
    parameters: ClassVar[tuple[Parameter, ...]] = CARE_PARAMETERS

    def __post_init__(self) -> None:
        super().__post_init__()
        require_allowed(self, self.parameters)
        if self.person_pose is not None:
            holds = np.shape(self.person_pose) == (POSE_SIZE,)
            holds = holds and bool(np.isfinite(self.person_pose).all())
            require("person_pose", self.person_pose, holds, f"{POSE_SIZE} finite numbers")

    @property
    def sides(self) -> tuple[str, str]:
        """Side of the person that each of the robot's arms handles."""
        return SIDES

    @property
    def joint_parts(self) -> Mapping[str, tuple[str, ...]]:
        """Part of the observation -> the joint whose position it is.

        Or the three joints of which it is the bend of the middle one; see :meth:`parts_from`.
        """
        return {}

    # ---------------------------------------------------------------- the scene

    def scene_key(self) -> Hashable:
        """Tasks of the same kind share a scene."""
        return type(self), self.n_arms

    def build(self, spec: mujoco.MjSpec, arms: Arms, variant: int, decorated: bool) -> None:
        """Add bed and person, and what measures forces, torques and collisions."""
        add_bed(spec, self.bed, BED)
        add_limp_person(spec, PEOPLE[variant], self.bed.centre, skins=decorated)
        add_load_sensors(spec, [*(arms.body(index) for index in range(arms.n)), *self.pressers])
        add_collision_counters(spec, arms, [[BED]] * arms.n)

    @cached_property
    def resting(self) -> tuple[Resting, ...]:
        """The person's parts, on the bed, on the table and on one another."""
        spec = mujoco.MjSpec()
        add_limp_person(spec, PEOPLE[0], skins=False)
        parts = [geom.name for geom in spec.geoms]
        on_bed = [(part, place) for part in parts for place in (BED, "table")]
        return (*on_bed, *combinations(parts, 2))

    # ---------------------------------------------------------------- episodes

    def posture(self, index: int, generator: np.random.Generator) -> LyingPosture:
        """Draw how a person is laid down, before the person comes to rest.

        :param index: which of the settled postures it will be.
        :param generator: source of randomness.
        """
        raise NotImplementedError

    def keeps(self, world: LyingWorld, index: int) -> bool:
        """Return whether a person came to rest as the task wants it; all do by default.

        :param world: in which the person rests.
        :param index: of the posture.
        """
        return True

    def drawn_person(self, generator: np.random.Generator) -> dict[str, Any]:
        """Draw who lies how on the bed.

        :param generator: the episode's source of randomness.
        :return: the fields of a :class:`saver_envs.tasks.care_starts.CareStart`, but for the hands.
        """
        who = self.people[generator.integers(len(self.people))]
        index = int(generator.integers(self.postures))
        values = {name: float(generator.uniform(*ends)) for name, ends in self.ranges.items()}
        known = {name: getattr(self, name) for name in self.ranges}
        values |= {name: value for name, value in known.items() if value is not None}
        who = who if self.person_body is None else self.person_body
        shift = np.array([values["person_x"], values["person_y"], values["person_yaw"]])
        return {
            "who": who,
            "pose": moved(self._lying(who, index), self.bed.centre, shift),
            "stiffness": values["person_stiffness"],
            "friction": values["person_friction"],
            "bed_friction": values["bed_friction"],
        }

    def _lying(self, who: int, index: int) -> NDArray[np.float64]:
        """Return how a person lies (35,) at the usual place on the bed."""
        if self.person_pose is None:
            return settled(self.name)[who, index]
        x, y, height = self.bed.centre
        pose = moved(np.array(self.person_pose), (0.0, 0.0), np.array([x, y, self.facing]))
        pose[2] += height
        return pose

    def unplaced(self, pose: NDArray[np.float64]) -> tuple[float, ...]:
        """Return how a person lies, wherever the bed is: the option ``person_pose``.

        The pelvis is over the origin, the surface of the bed at height 0, and feet point along +x.

        :param pose: (35,) of a person on the bed.
        """
        w, x, y, z = pose[3:7]
        heading = math.atan2(2 * (x * y + w * z), 1 - 2 * (y**2 + z**2))
        level = moved(pose, pose[:2], np.array([*-pose[:2], -heading]))
        level[2] -= self.bed.centre[2]
        return tuple(level.tolist())

    def pose_of(self, simulation: Simulation, row: int) -> tuple[float, ...]:
        """Return how the person of an episode lies now, for the bed of any care task.

        :param simulation: of the episodes.
        :param row: which of them.
        """
        return self.unplaced(simulation.qpos[row, simulation.keep(LimpPeople).layout.qpos])

    def memory(self, n: int) -> Memory:
        """Return the memory of who lies there, and since when parts are pressed."""
        person = {name: np.ones(n) for name in _REMEMBERED} | {"who": np.zeros(n, np.intp)}
        return load_memory(n) | person

    def place(
        self, simulation: Simulation, memory: Memory, rows: Rows, starts: Sequence[Any]
    ) -> None:
        """Lay the people down, and put the arms where the starts say, hands open."""
        self.lay(simulation, memory, rows, starts)
        simulation.refresh(rows)

    def lay(
        self, simulation: Simulation, memory: Memory, rows: Rows, starts: Sequence[Any]
    ) -> None:
        """Do what :meth:`place` does, but leave derived quantities as they are."""
        scene, robot = simulation.scene, simulation.scene.robot
        for name in _REMEMBERED:
            memory[name][rows] = [getattr(start, name) for start in starts]
        memory["contact_since"][rows] = 0.0
        self._give(simulation, memory, rows)
        hand = np.stack([start.hand for start in starts])
        joints = reachability_map(robot).postures_at(hand.reshape(-1, 3))
        fingers = np.full((len(rows), *scene.finger_qpos.shape), robot.finger_open)
        simulation.reset(rows, joints.reshape(len(rows), self.n_arms, -1), fingers)
        poses = np.stack([start.pose for start in starts])
        simulation.keep(LimpPeople).lay(rows, poses)

    def restore(self, simulation: Simulation, memory: Memory) -> None:
        """Restore the people in the memory, and their beds."""
        self._give(simulation, memory, np.arange(simulation.n))

    def _give(self, simulation: Simulation, memory: Memory, rows: Rows) -> None:
        who, stiffness, friction, bed = (memory[name][rows] for name in _REMEMBERED)
        simulation.keep(LimpPeople).give(rows, who, stiffness, friction)
        geom = simulation.scene.model.geom(BED).id
        simulation.per_simulation("geom_friction")[rows, geom, 0] = bed

    def measure(
        self, simulation: Simulation, memory: Memory, achieved: FloatArray, desired: FloatArray
    ) -> dict[str, NDArray[np.float64]]:
        """Return costs and readings: force (N) on each part, torque (N m) on each joint."""
        measured = super().measure(simulation, memory, achieved, desired)
        return measured | simulation.keep(PersonLoads).readings(memory)

    # ---------------------------------------------------------------- pictures and the page

    def parts_from(self, joints: Mapping[str, NDArray[np.float64]], scene: Scene) -> Seen:
        """Return what of the observation depends on where the person's joints are.

        :param joints: name, such as ``left_wrist`` -> (n, 3) in the world, metres.
        :param scene: of the episodes.
        :return: part -> (n, arms, size).
        """
        seen: Seen = {}
        for part, names in self.joint_parts.items():
            own = [np.stack([joints[f"{side}_{one}"] for side in self.sides], 1) for one in names]
            seen[part] = scene.to_bases(own[0]) if len(own) == 1 else bend(*own)
        return seen

    def goal_from(
        self, joints: Mapping[str, NDArray[np.float64]], scene: Scene
    ) -> NDArray[np.float64] | None:
        """Return the desired goals (n, goal size) that follow from where the person's joints are.

        None, as by default, where the goal does not depend on the person.

        :param joints: as for :meth:`parts_from`.
        :param scene: of the episodes.
        """
        return None

    def variant_of(self, memory: Memory, row: int) -> int:
        """Return who lies in episode ``row``."""
        return int(memory["who"][row])


def bend(first: FloatArray, middle: FloatArray, last: FloatArray) -> NDArray[np.float64]:
    """Return by how much limbs are bent at a joint, (..., 1), radians: 0 where they are straight.

    :param first: (..., 3) the joint before it.
    :param middle: (..., 3) where it is bent.
    :param last: (..., 3) the joint after it.
    """
    upper, lower = middle - first, last - middle
    lengths = np.linalg.norm(upper, axis=-1) * np.linalg.norm(lower, axis=-1)
    cosine = (upper * lower).sum(axis=-1) / np.maximum(lengths, 1e-9)
    return np.arccos(np.clip(cosine, -1.0, 1.0))[..., None]


def cost_text() -> dict[str, str]:
    """Return when the costs of forces and torques are 1, and that of collisions."""
    forces = {}
    for part, limit in FORCE_LIMITS.items():
        text = f"1 on a step with more than {limit:g} N on the {part.replace('_', ' ')}"
        if part not in NEVER_MORE:
            brief = TRANSIENT_FACTOR * limit
            text += f" for {LASTING:g} s or longer, or more than {brief:g} N"
        forces[f"force_{part}"] = text
    torques = dict.fromkeys(
        TORQUE_COSTS, "1 on a step with a harmful torque against the end of a range"
    )
    collision = "1 on a step with contact between arms, or of an arm with the table or the bed"
    return {"collision": collision, **forces, **torques}


def start_text(people: int, ranges: Mapping[str, tuple[float, float]] = RANGES) -> list[str]:
    """Return what all starts have, a sentence each.

    :param people: how many may lie there.
    :param ranges: from which starts are drawn.
    """

    def span(name: str) -> str:
        return f"{ranges[name][0]:g} to {ranges[name][1]:g}"

    x, y, turn = (ranges[name][1] for name in ("person_x", "person_y", "person_yaw"))
    return [
        f"One of {people} people lies on the bed at rest, up to {100 * x:g} cm along x and "
        f"{100 * y:g} cm along y from the middle, turned by up to {turn:g} rad.",
        f"Friction of clothes and skin {span('person_friction')}, of person and bed "
        f"{span('bed_friction')}; stiffness and damping of the joints times "
        f"{span('person_stiffness')}.",
    ]
