"""Cubes: one per arm, with a target of the same colour."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.randomization import Choice, LogUniform, Parameter, Uniform
from saver_envs.randomization.parameters import require_allowed
from saver_envs.scenes import (
    ARM_COLOURS,
    OBJECT_BIT,
    TARGET,
    Arms,
    add_collision_counters,
    add_target,
    finger_geoms,
    free_bodies,
)
from saver_envs.simulation import Simulation
from saver_envs.tasks.arm_and_object import ArmAndObjectTask
from saver_envs.tasks.contract import Memory, Rows
from saver_envs.world import TABLE_BIT, move_table

#: What may differ between episodes; nominal values are those of the tasks' options.
OBJECT_PARAMETERS = (
    Parameter(
        # Edges of cubes that these hands can push within their reach.
        *("object_size", "m", "edge of the cubes", 0.056, (0.035, 0.12)),
        wide=Uniform(0.04, 0.09),
        held_out=Choice((Uniform(0.035, 0.04), Uniform(0.095, 0.11))),
    ),
    Parameter(
        *("object_mass", "kg", "mass of a cube", 0.2, (0.001, 100.0)),
        wide=LogUniform(0.05, 0.8),
        held_out=Uniform(0.8, 1.2),
    ),
    Parameter(
        *("object_friction", "", "sliding friction of cubes and table", 0.5, (0.0, 10.0)),
        wide=Uniform(0.2, 1.0),
        held_out=Choice((Uniform(0.1, 0.2), Uniform(1.0, 1.3))),
    ),
    Parameter(
        *("finger_friction", "", "sliding friction of cubes and fingers", 1.5, (0.0, 10.0)),
        wide=Uniform(0.5, 1.5),
        held_out=Uniform(0.4, 0.5),
    ),
    Parameter(
        *("object_damping", "N s/m", "linear damping of the cubes' motion", 0.0, (0.0, 1000.0)),
        wide=Uniform(0.0, 2.0),
        held_out=Uniform(2.0, 3.0),
    ),
    Parameter(
        # Arms reach 2 cm below their usual table.
        *("table_height", "m", "height of the table above the arms' bases", 0.0, (-0.02, 0.05)),
        wide=Uniform(-0.01, 0.01),
    ),
    Parameter(
        *("object_shape", "", "shape of the objects, as high as their edge", 0, (0, 3)),
        whole=True,
        names=("cube", "cylinder", "block", "post"),
    ),
)
#: Options of the tasks that describe the cubes.
OBJECT_OPTIONS = tuple(one.name for one in OBJECT_PARAMETERS)
#: Shape -> its geom, and its width along x, along y and its height, as shares of the edge.
SHAPES = {
    "cube": (mujoco.mjtGeom.mjGEOM_BOX, (1.0, 1.0, 1.0)),
    "cylinder": (mujoco.mjtGeom.mjGEOM_CYLINDER, (1.0, 1.0, 1.0)),
    "block": (mujoco.mjtGeom.mjGEOM_BOX, (1.0, 0.6, 1.0)),
    "post": (mujoco.mjtGeom.mjGEOM_BOX, (0.6, 0.6, 1.0)),
}
_COMPILED_X = 0.4  # m, where cubes are before an episode begins


def cube_name(index: int) -> str:
    """Return the name of the body, and of the geom, of cube ``index``."""
    return f"object{index}"


@dataclass(frozen=True)
class CubeTask(ArmAndObjectTask):
    """Base of tasks with a cube and a target for each arm; all cubes are alike.

    :param object_size: edge of the cubes, m.
    :param object_mass: mass of a cube, kg.
    :param object_friction: sliding friction of cubes and table.
    :param finger_friction: sliding friction of cubes and fingers; by default the greater of the
        pads' own, 1.5, and ``object_friction``.
    :param object_damping: linear damping of the cubes' motion, N s/m.
    :param table_height: height of the table above the arms' bases, m.
    :param object_shape: ``cube``, ``cylinder``, ``block`` (of 0.6 of the width along y) or ``post``
        (of 0.6 of the width); all are as high as ``object_size``.
    """

    object_size: float = 0.056
    object_mass: float = 0.2
    object_friction: float = 0.5
    finger_friction: float | None = None
    object_damping: float = 0.0
    table_height: float = 0.0
    object_shape: str = "cube"

    parameters: ClassVar[tuple[Parameter, ...]] = OBJECT_PARAMETERS

    def __post_init__(self) -> None:
        super().__post_init__()
        require_allowed(self, self.parameters)

    @property
    def resting(self) -> tuple[str, ...]:
        """Names of the cubes' bodies, and of their geoms."""
        return tuple(cube_name(index) for index in range(self.n_arms))

    def scene_key(self) -> Hashable:
        """Tasks with the same cubes share a scene."""
        return "cubes", self.n_arms, *(getattr(self, name) for name in OBJECT_OPTIONS)

    def build(self, spec: mujoco.MjSpec, arms: Arms, variant: int, decorated: bool) -> None:
        """Add cubes, targets, and sensors that count collisions."""
        for index, name in enumerate(self.resting):
            place = (_COMPILED_X, 0.1 * index, self.object_size / 2 + self.table_height)
            body = spec.worldbody.add_body(name=name, pos=place)
            body.add_freejoint(name=f"{name}_joint")
            if self.object_damping:
                body.joints[0].damping = (self.object_damping, 0, 0)
            body.add_geom(
                name=name,
                type=SHAPES[self.object_shape][0],
                size=geom_sizes(np.array([self.object_size]), [self.object_shape])[0],
                mass=self.object_mass,
                friction=(self.object_friction, 0.02, 0.001),
                condim=3,
                contype=OBJECT_BIT,
                conaffinity=TABLE_BIT | OBJECT_BIT,
                rgba=(*ARM_COLOURS[index], 1),
            )
            add_target(spec, index, self.object_size / 2, place)
        others = [[one for one in self.resting if one != own] for own in self.resting]
        add_collision_counters(spec, arms, others)
        if self.finger_friction is not None:
            for index, pad in product(range(arms.n), finger_geoms(arms.robot, arms.fingers)):
                geom = spec.geom(f"arm{index}_{pad}")
                # Of two geoms, that with the higher priority decides about their friction.
                geom.priority, geom.friction[0] = 1, self.finger_friction

    def compiled(self, model: mujoco.MjModel) -> None:
        """Set the damping of the cubes' rotation.

        A free joint has one damping for all its motions, which would block rotation. It is damped,
        in N m s/rad, as if the drag acted on one face: by ``object_damping`` times the mean squared
        distance of the face's points from its centre, a sixth of the squared edge.
        """
        for name in self.resting:
            turning = model.joint(f"{name}_joint").dofadr[0] + np.arange(3, 6)
            model.dof_damping[turning] = self.object_damping * self.object_size**2 / 6

    def decorate(self, model: mujoco.MjModel, memory: Memory, row: int) -> None:
        """Show cubes and table as they are in the episode."""
        for index, name in enumerate(self.resting):
            geom, target = model.geom(name), model.site(f"{TARGET}{index}")
            geom.type[:] = int(SHAPES[self.object_shape][0])
            geom.size[:] = geom_sizes(np.array([self.object_size]), [self.object_shape])[0]
            target.size[0] = self.object_size / 2
            geom.rbound[:] = np.sqrt(3) * self.object_size / 2
        move_table(model, self.table_height)

    def vary(
        self, simulation: Simulation, rows: Rows, values: Mapping[str, NDArray[np.float64]]
    ) -> None:
        """Give some simulations cubes, pads and a table of their own.

        :param simulation: of a scene with these cubes.
        :param rows: (k,) which simulations.
        :param values: parameter -> (k, 1).
        """
        scene, field, every = simulation.scene, simulation.per_simulation, rows[:, None]
        own, base = free_bodies(scene, self.resting), scene.model
        geoms = np.array([base.geom(name).id for name in self.resting])
        bodies = base.geom_bodyid[geoms]

        def value(name: str, nominal: float) -> NDArray[np.float64]:
            return values.get(name, np.full((len(rows), 1), nominal))

        size, mass = value("object_size", self.object_size), value("object_mass", self.object_mass)
        table = value("table_height", self.table_height)
        damping = value("object_damping", self.object_damping)[..., None]
        half = size / 2
        turning = damping * size[..., None] ** 2 / 6
        shapes = [self.object_shape] * len(rows)
        if "object_shape" in values:
            shapes = [list(SHAPES)[int(index)] for index in values["object_shape"][:, 0]]
            field("geom_type")[every, geoms] = np.array([[int(SHAPES[one][0])] for one in shapes])
        sizes = geom_sizes(size[:, 0], shapes)
        inertia = np.stack(
            [inertia_of(*one) for one in zip(mass[:, 0], sizes, shapes, strict=True)]
        )
        field("geom_size")[every, geoms] = sizes[:, None]
        field("body_mass")[every, bodies] = mass
        field("body_inertia")[every, bodies] = inertia[:, None]
        field("dof_damping")[every[..., None], own.dof[:, :3]] = damping
        field("dof_damping")[every[..., None], own.dof[:, 3:]] = turning
        field("geom_friction")[every, geoms, 0] = value("object_friction", self.object_friction)
        field("geom_pos")[every, base.geom("table").id, 2] = table
        field("body_pos")[every, bodies, 2] = half + table
        for name in ("qpos0", "qpos_spring"):
            field(name)[every, own.qpos[:, 2]] = half + table
        field("site_pos")[every, scene.target_site, 2] = half + table
        field("site_size")[every, scene.target_site, 0] = half
        if "finger_friction" in values:
            pads = scene.finger_geom.ravel()
            field("geom_priority")[every, pads] = 1
            field("geom_friction")[every, pads, 0] = values["finger_friction"]


def geom_sizes(edge: NDArray[np.float64], shapes: Sequence[str]) -> NDArray[np.float64]:
    """Return the sizes (k, 3) of the geoms of objects, as MuJoCo counts them.

    :param edge: (k,) metres.
    :param shapes: k of :data:`SHAPES`.
    """
    half = edge[:, None] / 2 * np.array([SHAPES[one][1] for one in shapes])
    return np.stack(
        [
            (x, z, 0.0) if SHAPES[shape][0] == mujoco.mjtGeom.mjGEOM_CYLINDER else (x, y, z)
            for (x, y, z), shape in zip(half, shapes, strict=True)
        ]
    )


def inertia_of(mass: float, size: NDArray[np.float64], shape: str) -> NDArray[np.float64]:
    """Return the diagonal (3,) of an object's inertia, kg m^2, as MuJoCo's compiler computes it."""
    x, y, z = size
    if SHAPES[shape][0] == mujoco.mjtGeom.mjGEOM_CYLINDER:
        across = mass * (3 * x * x + 4 * y * y) / 12
        return np.array([across, across, mass * x * x / 2])
    return np.array([y * y + z * z, x * x + z * z, x * x + y * y]) * mass / 3
