"""Base of the tasks at a table: a cube for each arm, and a target for each cube."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import Any, ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.control import Workspace
from saver_envs.randomization import Parameter
from saver_envs.randomization.parameters import require_allowed
from saver_envs.reachability import reachability_map
from saver_envs.scenes import Arms, Bases, FreeBodies, Scene, free_bodies
from saver_envs.simulation import ArmState, Simulation
from saver_envs.tasks.arm_and_object import ArmAndObjectTask, hand_parts, object_parts
from saver_envs.tasks.contract import Memory, Rows, Seen, TaskPage
from saver_envs.tasks.cubes import OBJECT_OPTIONS, OBJECT_PARAMETERS, Cubes
from saver_envs.tasks.grasping import settled_grasp
from saver_envs.tasks.regions import OVERLAP, Regions, regions
from saver_envs.tasks.sampling import StartRules, StartSampler, TableStart, start_text
from saver_envs.validation import require

#: Cubes whose edges differ by less (m) are held alike.
_GRASP_STEP = 0.002


@dataclass(frozen=True)
class TableTask(ArmAndObjectTask):
    """Cubes to targets on a table; subclasses say how they are moved and what else is asked.

    :param object_size: edge of the cubes, m.
    :param object_mass: mass of a cube, kg.
    :param object_friction: sliding friction of cubes and table.
    :param finger_friction: sliding friction of cubes and fingers; by default the greater of the
        pads' own, 1.5, and ``object_friction``.
    :param object_damping: linear damping of the cubes' motion, N s/m.
    :param table_height: height of the table above the arms' bases, m.
    :param object_shape: ``cube``, ``cylinder``, ``block`` (of 0.6 of the width along y) or ``post``
        (of 0.6 of the width); all are as high as ``object_size``.
    :param layout: bases in a ``row`` or a ``ring`` round the table.
    :param overlap: how far an arm's box reaches beyond the middle line to its neighbour, m.
    """

    object_size: float = Cubes.size
    object_mass: float = Cubes.mass
    object_friction: float = Cubes.friction
    finger_friction: float | None = Cubes.finger_friction
    object_damping: float = Cubes.damping
    table_height: float = Cubes.table_height
    object_shape: str = Cubes.shape
    layout: Bases = "row"
    overlap: float = OVERLAP

    parameters: ClassVar[tuple[Parameter, ...]] = OBJECT_PARAMETERS

    def __post_init__(self) -> None:
        super().__post_init__()
        require_allowed(self, self.parameters)
        require("overlap", self.overlap, 0 <= self.overlap <= 0.2, "0 to 0.2 m")
        self.start_rules()  # which checks the options that it takes

    @cached_property
    def cubes(self) -> Cubes:
        """The cubes of the scene."""
        return Cubes(
            self.n_arms,
            **{name.removeprefix("object_"): getattr(self, name) for name in OBJECT_OPTIONS},
        )

    @property
    def bases(self) -> Bases:
        """How the arms' bases stand."""
        return self.layout

    @property
    def resting(self) -> tuple[str, ...]:
        """The cubes."""
        return self.cubes.names

    def start_rules(self) -> StartRules:
        """Return the rules of a start."""
        raise NotImplementedError

    def rules(self, **own: Any) -> StartRules:
        """Return rules of a start, those that are options with the values of these.

        :param own: the other rules.
        """
        options = vars(self).keys() & {one.name for one in fields(StartRules)}
        return StartRules(**{name: getattr(self, name) for name in options}, **own)

    # ---------------------------------------------------------------- the scene

    def scene_key(self) -> Hashable:
        """Tasks with the same cubes share a scene."""
        return self.cubes

    def build(self, spec: mujoco.MjSpec, arms: Arms, variant: int, decorated: bool) -> None:
        """Add a cube and a target for each arm."""
        self.cubes.build(spec, arms, variant, decorated)

    def compiled(self, model: mujoco.MjModel) -> None:
        """Set the damping of the cubes' turning."""
        self.cubes.compiled(model)

    def regions(self, arms: Arms) -> Regions:
        """Return the boxes of hands, cubes and targets."""
        found = regions(arms, self.overlap)
        return replace(found, workspace=found.workspace.raised(self.table_height))

    def workspace(self, arms: Arms) -> Workspace:
        """Return where set-points may be."""
        return self.regions(arms).workspace

    def vary(
        self, simulation: Simulation, rows: Rows, values: Mapping[str, NDArray[np.float64]]
    ) -> None:
        """Give some simulations their own cubes and table."""
        self.cubes.vary(simulation, rows, dict(values))

    # ---------------------------------------------------------------- episodes

    def sample(self, generator: np.random.Generator, scene: Scene) -> TableStart:
        """Draw hands, cubes and targets that keep :meth:`start_rules`."""
        return _sampler(self, scene).sample(generator)

    def place(
        self, simulation: Simulation, memory: Memory, rows: Rows, starts: Sequence[TableStart]
    ) -> None:
        """Put arms, fingers and cubes where the starts say."""
        scene, robot = simulation.scene, simulation.scene.robot
        hand = np.stack([start.hand for start in starts])
        position = np.stack([start.object for start in starts])
        held = np.stack([start.held for start in starts])
        joints = reachability_map(robot).postures_at(hand.reshape(-1, 3))
        fingers = np.full((len(rows), *scene.finger_qpos.shape), robot.finger_open)
        quaternion = np.zeros((len(rows), self.n_arms, 4))
        quaternion[..., 0] = 1
        for index, arm in np.argwhere(held):
            grasp = settled_grasp(robot, self._grasped(starts[index].object_size))
            position[index, arm] = hand[index, arm] + grasp.object_offset
            quaternion[index, arm] = grasp.object_quaternion
            fingers[index, arm] = grasp.finger_position
        simulation.reset(rows, joints.reshape(len(rows), self.n_arms, -1), fingers)
        poses = np.concatenate([scene.to_world(position), quaternion], axis=-1)
        simulation.qpos[rows[:, None, None], self._cubes(simulation).qpos] = poses
        simulation.refresh(rows)
        episode, arm = np.nonzero(held)
        simulation.ctrl[rows[episode][:, None], scene.finger_ctrl[arm]] = robot.finger_closed

    def _grasped(self, size: float) -> Cubes:
        """Return the cube whose grasp is that of a cube of this size, or of a similar one."""
        if size != self.object_size:
            size = round(size / _GRASP_STEP) * _GRASP_STEP
        return replace(self.cubes, n=1, size=size)

    def valid(
        self, simulation: Simulation, memory: Memory, rows: Rows, starts: Sequence[TableStart]
    ) -> NDArray[np.bool_]:
        """Return which starts have contacts only of cubes with the table, or hold a cube."""
        held = np.array([start.held.any() for start in starts])
        return super().valid(simulation, memory, rows, starts) | held

    def observe(self, simulation: Simulation, memory: Memory, arms: ArmState) -> Seen:
        """Return hands and cubes, and where the cubes are in the world's frame."""
        objects = simulation.object_state(self._cubes(simulation))
        world = {"object world position": objects.world_position}
        return hand_parts(simulation, arms) | object_parts(arms, objects) | world

    def _cubes(self, simulation: Simulation) -> FreeBodies:
        return free_bodies(simulation.scene, self.resting)

    def decorate(self, model: mujoco.MjModel, memory: Memory, row: int) -> None:
        """Show cubes and table as they are in the episode."""
        self.cubes.draw(model)

    # ---------------------------------------------------------------- the page

    def page(self, scene: Scene) -> TaskPage:
        """Return the text that tasks with cubes share."""
        rules = self.start_rules()
        if not _sampler(self, scene).contestable:
            rules = replace(rules, contested_share=0.0)
        subject = "the cube is" if self.n_arms == 1 else "every cube is"
        where = " on the table" if self.held_height is not None else ", on the table or in the air"
        within = f"within {100 * self.success_threshold:g} cm of its target"
        cubes = self.cubes
        facts = f"{100 * cubes.size:g} cm, {cubes.mass:g} kg, friction {cubes.friction:g}"
        return TaskPage(
            succeeds=f"{subject} {within}{where}",
            start=start_text(self.n_arms, rules, self.regions(scene.arms)),
            reward="0 where every cube is within the threshold of its target, else -1.",
            dense="minus the sum of the cubes' distances to their targets, in metres.",
            costs={
                "collision": (
                    "1 on a step with contact between arms, or of an arm with the table or with "
                    "another arm's cube"
                )
            },
            goal={"object position": "centre of the cube (achieved), its target (desired)"},
            facts=(("cubes", facts),),
        )


@lru_cache(maxsize=64)
def _sampler(task: TableTask, scene: Scene) -> StartSampler:
    reachability = reachability_map(scene.robot)
    return StartSampler(scene, task.regions(scene.arms), reachability, task.start_rules())
