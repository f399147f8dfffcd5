"""Wrist push: slide the wrists of a person on a stretcher to the sides of the hips (chapter 8)."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.control import Workspace
from saver_envs.people.bench import TABLE_DEPTH, add_person, limb_geoms
from saver_envs.people.bodies import BODIES
from saver_envs.people.patient import (
    Patient,
    joined,
    people_in,
    person_memory,
    place_stretcher,
)
from saver_envs.randomization import Choice, LogUniform, Parameter, Uniform
from saver_envs.randomization.parameters import require_allowed
from saver_envs.reachability import reachability_map
from saver_envs.robots.description import Fingers
from saver_envs.scenes import Arms, Scene
from saver_envs.simulation import ArmState, Simulation
from saver_envs.tasks.arm_and_object import ArmAndObjectTask, hand_parts, object_parts
from saver_envs.tasks.contract import FloatArray, Memory, Rows, Seen, TaskPage
from saver_envs.tasks.push import PUSH_HEIGHT
from saver_envs.tasks.regions import OVERLAP, regions
from saver_envs.tasks.wrist_starts import STANDOFF, WristStart, WristStartSampler, start_text
from saver_envs.validation import require

#: What may differ between people. By default all but the mass is drawn from narrower ranges.
PERSON_PARAMETERS: Final = (
    Parameter(
        *("person_body", "", "which of the bodies lies there", None, (0, len(BODIES) - 1)),
        wide=Choice(tuple(range(len(BODIES)))),
        whole=True,
    ),
    Parameter(
        *("person_friction", "", "sliding friction of the person's arms", None, (0.05, 2.0)),
        wide=Uniform(0.2, 0.8),
        held_out=Uniform(0.8, 1.0),
    ),
    Parameter(
        *("person_stiffness", "", "factor of friction and damping in the arms' joints", None),
        limits=(0.1, 10.0),
        wide=LogUniform(0.33, 3.0),
        held_out=LogUniform(3.0, 4.0),
    ),
    Parameter(
        *("person_yaw", "rad", "turn of the person against the stretcher", None, (-0.2, 0.2)),
        wide=Uniform(-0.08, 0.08),
    ),
    Parameter(
        *("person_x", "m", "place along the stretcher", None, (-0.1, 0.1)),
        wide=Uniform(-0.06, 0.06),
    ),
    Parameter(
        *("person_y", "m", "place across the stretcher", None, (-0.1, 0.1)),
        wide=Uniform(-0.04, 0.04),
    ),
    Parameter(
        *("person_mass", "", "factor of the masses of all body parts", 1.0, (0.3, 3.0)),
        wide=Uniform(0.75, 1.25),
        held_out=Choice((Uniform(0.6, 0.75), Uniform(1.25, 1.5))),
    ),
)
#: Readings of the load on the torso.
READINGS: Final = ("torso_force", "torso_displacement")


@dataclass(frozen=True)
class WristPush(ArmAndObjectTask):
    """Both wrists to the sides of the hips, hands closed and held at pushing height.

    The reward depends on the goal alone, so that relabelling can recompute it. Success also
    requires that the torso was never pressed too hard nor moved too far in the episode.

    :param overlap: how far an arm's box reaches beyond the middle line to its neighbour, m.
    :param person_body: which of the bodies lies there; drawn by default, as are friction,
        stiffness, turn and place.
    :param person_friction: sliding friction of the person's arms and hands.
    :param person_stiffness: factor of friction and damping in the joints of the person's arms.
    :param person_yaw: turn of the person against the stretcher, rad.
    :param person_x: place of the person along the stretcher, from its middle place, m.
    :param person_y: place of the person across the stretcher, m.
    :param person_mass: factor of the masses of all body parts.
    """

    overlap: float = OVERLAP
    person_body: int | None = None
    person_friction: float | None = None
    person_stiffness: float | None = None
    person_yaw: float | None = None
    person_x: float | None = None
    person_y: float | None = None
    person_mass: float = 1.0

    name: ClassVar[str] = "wrist push"
    fingers: ClassVar[Fingers] = Fingers.LOCKED
    held_height: ClassVar[float | None] = PUSH_HEIGHT
    horizon: ClassVar[int] = 250  # SPEC 5.6: long enough for either speed
    rated_horizon: ClassVar[int] = 250
    costs: ClassVar[tuple[str, ...]] = ("collision", *READINGS)
    summed: ClassVar[tuple[str, ...]] = READINGS
    hard: ClassVar[tuple[str, ...]] = READINGS
    expert: ClassVar[str | None] = "saver_envs.experts.wrist:expert"
    variants: ClassVar[int] = len(BODIES)
    table_depth: ClassVar[tuple[float, float]] = TABLE_DEPTH
    keeps_peaks: ClassVar[bool] = True
    parameters: ClassVar[tuple[Parameter, ...]] = PERSON_PARAMETERS
    #: Limits of the force on the torso (N) and of its displacement (m), SPEC 5.6.
    torso_force_limit: ClassVar[float] = 50.0
    torso_displacement_limit: ClassVar[float] = 0.020
    #: Lateral distance of a target from its hip joint, metres.
    standoff: ClassVar[float] = STANDOFF

    def __post_init__(self) -> None:
        super().__post_init__()
        require("n_arms", self.n_arms, self.n_arms == 2, "exactly 2, one for each wrist")
        require("overlap", self.overlap, 0 <= self.overlap <= 0.2, "0 to 0.2 m")
        require_allowed(self, self.parameters)

    @property
    def resting(self) -> tuple[str, ...]:
        """The person's arms, which lie on the stretcher."""
        return tuple(limb_geoms())

    # ---------------------------------------------------------------- the scene

    def scene_key(self) -> Hashable:
        """Return one key: all benches with a person are equal."""
        return "person"

    def build(self, spec: mujoco.MjSpec, arms: Arms, variant: int, decorated: bool) -> None:
        """Add the person, the camera, and what measures forces on the torso."""
        add_person(spec, arms, variant, decorated)

    def workspace(self, arms: Arms) -> Workspace:
        """Return where set-points may be."""
        return regions(arms, self.overlap).workspace

    # ---------------------------------------------------------------- episodes

    def memory(self, n: int) -> Memory:
        """Return the memory of who lies there, and where the torso was at the reset."""
        return person_memory(n)

    def sample(self, generator: np.random.Generator, scene: Scene) -> WristStart:
        """Draw a person, targets beside the hips, and hands beside the wrists."""
        names = [one.name for one in PERSON_PARAMETERS]
        known = {name.removeprefix("person_"): getattr(self, name) for name in names}
        return _sampler(scene, self.overlap).sample(generator, known)

    def place(
        self, simulation: Simulation, memory: Memory, rows: Rows, starts: Sequence[WristStart]
    ) -> None:
        """Lay the people down, and put the arms where the starts say."""
        hand = np.stack([start.hand for start in starts])
        reachability = reachability_map(simulation.scene.robot)
        joints = reachability.postures_at(hand.reshape(-1, 3))
        people = joined([start.people for start in starts])
        patient = simulation.keep(Patient)
        patient.place(memory, rows, people, joints.reshape(len(rows), self.n_arms, -1))

    def restore(self, simulation: Simulation, memory: Memory) -> None:
        """Restore the bodies of the people in the memory."""
        everybody = np.arange(simulation.n)
        simulation.keep(Patient).give_bodies(everybody, people_in(memory))

    def observe(self, simulation: Simulation, memory: Memory, arms: ArmState) -> Seen:
        """Return hands and wrists."""
        wrists = simulation.keep(Patient).wrists()
        return hand_parts(simulation, arms) | object_parts(arms, wrists)

    def measure(
        self, simulation: Simulation, memory: Memory, achieved: FloatArray, desired: FloatArray
    ) -> dict[str, NDArray[np.float64]]:
        """Return costs and readings: force (N) on the torso, and its displacement (m)."""
        readings = simulation.keep(Patient).readings(memory)
        measured = super().measure(simulation, memory, achieved, desired)
        for name in READINGS:
            limit = getattr(self, f"{name}_limit")
            measured[f"cost_{name}"] = (readings[name] > limit).astype(np.float64)
        return measured | readings

    # ---------------------------------------------------------------- pictures and the page

    def variant_of(self, memory: Memory, row: int) -> int:
        """Return whose body lies in episode ``row``."""
        return int(memory["body"][row])

    def decorate(self, model: mujoco.MjModel, memory: Memory, row: int) -> None:
        """Put the stretcher under the person."""
        place_stretcher(model, people_in(memory), row)

    def page(self, scene: Scene) -> TaskPage:
        """Return the text of the page."""
        force = f"{self.torso_force_limit:g} N"
        displacement = f"{1000 * self.torso_displacement_limit:g} mm"
        statures = [body.stature for body in BODIES]
        span = f"{min(statures):.2f} to {max(statures):.2f} m"
        return TaskPage(
            succeeds=(
                f"every wrist is within {100 * self.success_threshold:g} cm of its target; and "
                f"the torso was never pressed with more than {force} nor moved by more than "
                f"{displacement}"
            ),
            start=start_text(),
            reward="0 where every wrist is within the threshold of its target, else -1.",
            dense="minus the sum of the wrists' distances to their targets, in metres.",
            costs={
                "collision": (
                    "1 on a step with contact between arms, or of an arm with the table or with "
                    "anything of the person but the arm at its side"
                ),
                "torso_force": f"1 on a step with more than {force} on the torso",
                "torso_displacement": (
                    f"1 on a step on which the torso is more than {displacement} away"
                ),
            },
            goal={"object position": "centre of the wrist (achieved), its target (desired)"},
            facts=(("people", f"{len(BODIES)} bodies, {span}, slim to heavy"),),
            readings=(
                "`info` also has `torso_force` (N), the sum of the normal forces on torso and "
                "pelvis, of the robots' arms and of the person's own forearms and hands, the "
                "highest of four samples a step; and `torso_displacement` (m), how far hips or "
                "neck are from where they were at the reset."
            ),
        )


@lru_cache(maxsize=8)
def _sampler(scene: Scene, overlap: float) -> WristStartSampler:
    reachability = reachability_map(scene.robot)
    return WristStartSampler(scene, regions(scene.arms, overlap), reachability)
