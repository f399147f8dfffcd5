"""Base of the tasks at a table: a cube for each arm, and a target for each cube."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saver_envs.control import Workspace
from saver_envs.reachability import reachability_map
from saver_envs.scenes import Arms, Bases, FreeBodies, Scene, free_bodies
from saver_envs.simulation import ArmState, Simulation
from saver_envs.tasks.arm_and_object import hand_parts, object_parts
from saver_envs.tasks.contract import Memory, Rows, Seen, TaskPage
from saver_envs.tasks.cubes import OBJECT_OPTIONS, CubeTask
from saver_envs.tasks.grasping import settled_grasp
from saver_envs.tasks.regions import OVERLAP, regions
from saver_envs.tasks.sampling import StartRules, StartSampler, TableStart, start_text
from saver_envs.validation import require

_RULES = {one.name for one in fields(StartRules)}
#: Cubes whose edges differ by less (m) are held alike.
_GRASP_STEP = 0.002


@dataclass(frozen=True)
class TableTask(CubeTask):
    """Cubes to targets on a table; subclasses say how they are moved and what else is asked.

    :param layout: bases in a ``row`` or a ``ring`` round the table.
    :param overlap: how far an arm's box reaches beyond the middle line to its neighbour, m.
    """

    layout: Bases = "row"
    overlap: float = OVERLAP

    def __post_init__(self) -> None:
        super().__post_init__()
        require("overlap", self.overlap, 0 <= self.overlap <= 0.2, "0 to 0.2 m")
        require("layout", self.layout, self.layout in ("row", "ring"), "'row' or 'ring'")
        self.start_rules()  # which checks the options that it takes

    @property
    def bases(self) -> Bases:
        """How the arms' bases stand."""
        return self.layout

    def start_rules(self) -> StartRules:
        """Return the rules of a start."""
        raise NotImplementedError

    def rules(self, **own: Any) -> StartRules:
        """Return rules of a start, those that are options with the values of these.

        :param own: the other rules.
        """
        options = vars(self).keys() & _RULES
        return StartRules(**{name: getattr(self, name) for name in options}, **own)

    # ---------------------------------------------------------------- the scene

    def workspace(self, arms: Arms) -> Workspace:
        """Return where set-points may be."""
        return regions(arms, self.overlap).workspace.raised(self.table_height)

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

    def _grasped(self, size: float) -> CubeTask:
        """Return the cube whose grasp is that of a cube of this size, or of a similar one."""
        if size != self.object_size:
            size = round(size / _GRASP_STEP) * _GRASP_STEP
        options = {name: getattr(self, name) for name in OBJECT_OPTIONS}
        return CubeTask(1, **{**options, "object_size": size})

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

    # ---------------------------------------------------------------- the page

    def page(self, scene: Scene) -> TaskPage:
        """Return the text that tasks with cubes share."""
        rules = self.start_rules()
        if not _sampler(self, scene).contestable:
            rules = replace(rules, contested_share=0.0)
        subject = "the cube is" if self.n_arms == 1 else "every cube is"
        where = " on the table" if self.held_height is not None else ", on the table or in the air"
        within = f"within {100 * self.success_threshold:g} cm of its target"
        size, friction = 100 * self.object_size, self.object_friction
        facts = f"{size:g} cm, {self.object_mass:g} kg, friction {friction:g}"
        return TaskPage(
            succeeds=f"{subject} {within}{where}",
            start=start_text(self.n_arms, rules, regions(scene.arms, self.overlap)),
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
    boxes, reachability = regions(scene.arms, task.overlap), reachability_map(scene.robot)
    return StartSampler(scene, boxes, reachability, task.start_rules())
