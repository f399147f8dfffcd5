"""Cubes: one per arm, with a target of the same colour."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.randomization import Choice, LogUniform, Parameter, Uniform
from saver_envs.randomization.presets import Values
from saver_envs.scenes import (
    ARM_COLOURS,
    COLLISION,
    OBJECT_BIT,
    TARGET,
    Arms,
    Content,
    add_contact_sensor,
    add_target,
    finger_geoms,
    free_bodies,
)
from saver_envs.simulation import Simulation
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
class Cubes(Content):
    """A cube and a target for each arm; all cubes are alike.

    :param n: number of cubes.
    :param size: edge length, metres.
    :param mass: kilograms.
    :param friction: sliding friction with the table, dimensionless.
    :param finger_friction: sliding friction with the fingers; ``None`` for the greater of the
        pads' own and ``friction``.
    :param damping: viscous drag on the cube's motion, N s/m; 0 for free sliding. Its rotation is
        damped, in N m s/rad, as if the drag acted on one face: by this times the mean squared
        distance of the face's points from its centre, a sixth of the squared edge.
    :param table_height: of its surface above the arms' bases, metres.
    :param shape: one of :data:`SHAPES`.
    """

    n: int
    size: float = 0.056
    mass: float = 0.2
    friction: float = 0.5
    damping: float = 0.0
    finger_friction: float | None = None
    table_height: float = 0.0
    shape: str = "cube"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the bodies, and of their geoms."""
        return tuple(cube_name(index) for index in range(self.n))

    def build(self, spec: mujoco.MjSpec, arms: Arms, variant: int, decorated: bool) -> None:
        """Add cubes, targets, and sensors that count collisions."""
        for index, name in enumerate(self.names):
            place = (_COMPILED_X, 0.1 * index, self.size / 2 + self.table_height)
            body = spec.worldbody.add_body(name=name, pos=place)
            body.add_freejoint(name=f"{name}_joint")
            if self.damping:
                body.joints[0].damping = (self.damping, 0, 0)
            body.add_geom(
                name=name,
                type=SHAPES[self.shape][0],
                size=geom_sizes(np.array([self.size]), [self.shape])[0],
                mass=self.mass,
                friction=(self.friction, 0.02, 0.001),
                condim=3,
                contype=OBJECT_BIT,
                conaffinity=TABLE_BIT | OBJECT_BIT,
                rgba=(*ARM_COLOURS[index], 1),
            )
            add_target(spec, index, self.size / 2, place)
        _add_collision_counters(spec, arms)
        if self.finger_friction is not None:
            for index, pad in product(range(arms.n), finger_geoms(arms.robot, arms.fingers)):
                geom = spec.geom(f"arm{index}_{pad}")
                # Of two geoms, that with the higher priority decides about their friction.
                geom.priority, geom.friction[0] = 1, self.finger_friction

    def compiled(self, model: mujoco.MjModel) -> None:
        """Set the damping of the cubes' rotation.

        A free joint has one damping for all its motions, which would block rotation.
        """
        for name in self.names:
            turning = model.joint(f"{name}_joint").dofadr[0] + np.arange(3, 6)
            model.dof_damping[turning] = self.damping * self.size**2 / 6

    def draw(self, model: mujoco.MjModel) -> None:
        """Give a drawing model these cubes and this table."""
        for index, name in enumerate(self.names):
            geom, target = model.geom(name), model.site(f"{TARGET}{index}")
            geom.type[:] = int(SHAPES[self.shape][0])
            geom.size[:] = geom_sizes(np.array([self.size]), [self.shape])[0]
            target.size[0] = self.size / 2
            geom.rbound[:] = np.sqrt(3) * self.size / 2
        move_table(model, self.table_height)

    def vary(self, simulation: Simulation, rows: NDArray[np.intp], values: Values) -> None:
        """Give some simulations cubes, pads and a table of their own.

        :param simulation: of a scene with these cubes.
        :param rows: (k,) which simulations.
        :param values: parameter -> (k, 1).
        """
        scene, field, every = simulation.scene, simulation.per_simulation, rows[:, None]
        own, base = free_bodies(scene, self.names), scene.model
        geoms = np.array([base.geom(name).id for name in self.names])
        bodies = base.geom_bodyid[geoms]

        def value(name: str, nominal: float) -> NDArray[np.float64]:
            return values.get(name, np.full((len(rows), 1), nominal))

        size, mass = value("object_size", self.size), value("object_mass", self.mass)
        table = value("table_height", self.table_height)
        damping = value("object_damping", self.damping)[..., None]
        half = size / 2
        turning = damping * size[..., None] ** 2 / 6
        shapes = [self.shape] * len(rows)
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
        field("geom_friction")[every, geoms, 0] = value("object_friction", self.friction)
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


def _add_collision_counters(spec: mujoco.MjSpec, arms: Arms) -> None:
    """Count contacts between arms, of arms with the table, and with other arms' cubes."""
    body, geom = mujoco.mjtObj.mjOBJ_XBODY, mujoco.mjtObj.mjOBJ_GEOM
    for index in range(arms.n):
        arm, name = arms.body(index), f"{COLLISION}arm{index}"
        add_contact_sensor(spec, f"{name}_table", arm, geom, "table")
        for other in range(arms.n):
            if other > index:
                add_contact_sensor(spec, f"{name}_arm{other}", arm, body, arms.body(other))
            if other != index:
                cube = cube_name(other)
                add_contact_sensor(spec, f"{name}_{cube}", arm, geom, cube)
