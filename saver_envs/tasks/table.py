"""Base of the tasks at a table: a cube for each arm, and a target for each cube."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.control import Workspace
from saver_envs.reachability import reachability_map
from saver_envs.scenes import Arms, Bases, FreeBodies, Scene, free_bodies
from saver_envs.simulation import ArmState, Simulation
from saver_envs.tasks.arm_and_object import ArmAndObjectTask, hand_parts, object_parts
from saver_envs.tasks.contract import Memory, Rows, Seen, TaskPage
from saver_envs.tasks.cubes import CUBE_SIZE, Cubes
from saver_envs.tasks.grasping import settled_grasp
from saver_envs.tasks.regions import OVERLAP, Regions, regions
from saver_envs.tasks.sampling import StartRules, StartSampler, TableStart
from saver_envs.tasks.table_page import table_page
from saver_envs.validation import require


@dataclass(frozen=True)
class TableTask(ArmAndObjectTask):
    """Cubes to targets on a table; subclasses say how they are moved and what else is asked.

    :param object_size: edge of the cubes, m.
    :param object_mass: mass of a cube, kg.
    :param object_friction: sliding friction of the cubes.
    :param object_damping: linear damping of the cubes' motion, N s/m.
    :param layout: bases in a ``row`` or a ``ring`` round the table.
    :param overlap: how far an arm's box reaches beyond the middle line to its neighbour, m.
    """

    object_size: float = Cubes.size
    object_mass: float = Cubes.mass
    object_friction: float = Cubes.friction
    object_damping: float = Cubes.damping
    layout: Bases = "row"
    overlap: float = OVERLAP

    def __post_init__(self) -> None:
        super().__post_init__()
        least, greatest = CUBE_SIZE
        size, mass = self.object_size, self.object_mass
        friction, damping = self.object_friction, self.object_damping
        require("object_size", size, least <= size <= greatest, f"{least} to {greatest} m")
        require("object_mass", mass, 0.001 <= mass <= 100, "0.001 to 100 kg")
        require("object_friction", friction, 0 <= friction <= 10, "0 to 10")
        require("object_damping", damping, 0 <= damping <= 1000, "0 to 1000 N s/m")
        require("overlap", self.overlap, 0 <= self.overlap <= 0.2, "0 to 0.2 m")

    @cached_property
    def cubes(self) -> Cubes:
        """The cubes of the scene."""
        size, mass = self.object_size, self.object_mass
        return Cubes(self.n_arms, size, mass, self.object_friction, self.object_damping)

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
        return regions(arms, self.overlap)

    def workspace(self, arms: Arms) -> Workspace:
        """Return where set-points may be."""
        return self.regions(arms).workspace

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
        if held.any():
            grasp = settled_grasp(robot, replace(self.cubes, n=1))
            position[held] = hand[held] + grasp.object_offset
            quaternion[held] = grasp.object_quaternion
            fingers[held] = grasp.finger_position
        simulation.reset(rows, joints.reshape(len(rows), self.n_arms, -1), fingers)
        poses = np.concatenate([scene.to_world(position), quaternion], axis=-1)
        simulation.qpos[rows[:, None, None], self._cubes(simulation).qpos] = poses
        simulation.refresh(rows)
        if held.any():
            episode, arm = np.nonzero(held)
            controls = scene.finger_ctrl[arm]
            simulation.ctrl[rows[episode][:, None], controls] = robot.finger_closed

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
        return table_page(self, self.cubes, rules, self.regions(scene.arms))


@lru_cache(maxsize=64)
def _sampler(task: TableTask, scene: Scene) -> StartSampler:
    reachability = reachability_map(scene.robot)
    return StartSampler(scene, task.regions(scene.arms), reachability, task.start_rules())
