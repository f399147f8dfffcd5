"""Cubes: one an arm, with a target of the same colour."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from saver_envs.scenes import (
    ARM_COLOURS,
    COLLISION,
    OBJECT_BIT,
    Arms,
    add_contact_counters,
    add_target,
)
from saver_envs.world import TABLE_BIT, TABLE_DEPTH

#: Edges of cubes (m) that can be pushed by these hands and lie on the table within their reach.
CUBE_SIZE = (0.04, 0.12)
_COMPILED_X = 0.4  # m, where cubes are before an episode begins


@dataclass(frozen=True)
class CubeProperties:
    """Cubes that the arms move, all alike.

    :param size: edge length, metres.
    :param mass: kilograms.
    :param friction: sliding friction with the table and the hands, dimensionless.
    :param damping: viscous drag on the cube's motion, N s/m; 0 for free sliding. Its turning is
        dragged, in N m s/rad, as if that came from one face: by the mean of the squared distances
        of the face's points from its middle, a sixth of the squared edge, times as much.
    """

    size: float = 0.056
    mass: float = 0.2
    friction: float = 0.5
    damping: float = 0.0


def cube_name(index: int) -> str:
    """Return the name of the body, and of the geom, of cube ``index``."""
    return f"object{index}"


@dataclass(frozen=True)
class Cubes:
    """A cube and a target for each arm, as what a scene holds.

    :param n: how many.
    :param cube: their properties.
    """

    n: int
    cube: CubeProperties

    variants: ClassVar[int] = 1
    table_depth: ClassVar[tuple[float, float]] = TABLE_DEPTH

    def scene_key(self) -> Cubes:
        """Return the cubes themselves: equal ones make equal scenes."""
        return self

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the bodies, and of their geoms."""
        return tuple(cube_name(index) for index in range(self.n))

    def build(self, spec: mujoco.MjSpec, arms: Arms, variant: int, decorated: bool) -> None:
        """Add cubes, targets, and sensors that count collisions."""
        for index in range(self.n):
            _add_cube(spec, index, self.cube)
        _add_collision_counters(spec, arms)

    def compiled(self, model: mujoco.MjModel) -> None:
        """Set the damping of the cubes' turning.

        A free joint has one damping for all its motions: as N m s/rad it would hold a cube fast.
        """
        for name in self.names:
            turning = model.joint(f"{name}_joint").dofadr[0] + np.arange(3, 6)
            model.dof_damping[turning] = self.cube.damping * self.cube.size**2 / 6


def _add_cube(spec: mujoco.MjSpec, index: int, cube: CubeProperties) -> None:
    """Add cube ``index`` and the site that shows its target."""
    place = (_COMPILED_X, 0.1 * index, cube.size / 2)
    body = spec.worldbody.add_body(name=cube_name(index), pos=place)
    body.add_freejoint(name=f"{cube_name(index)}_joint")
    if cube.damping:
        body.joints[0].damping = (cube.damping, 0, 0)
    body.add_geom(
        name=cube_name(index),
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=(cube.size / 2,) * 3,
        mass=cube.mass,
        friction=(cube.friction, 0.02, 0.001),
        condim=3,
        contype=OBJECT_BIT,
        conaffinity=TABLE_BIT | OBJECT_BIT,
        rgba=(*ARM_COLOURS[index], 1),
    )
    add_target(spec, index, cube.size / 2, place)


def _add_collision_counters(spec: mujoco.MjSpec, arms: Arms) -> None:
    """Count contacts between arms, of arms with the table, and with other arms' cubes."""
    pairs: list[tuple[str, int, str, int, str]] = []
    body, geom = int(mujoco.mjtObj.mjOBJ_XBODY), int(mujoco.mjtObj.mjOBJ_GEOM)
    for index in range(arms.n):
        arm = arms.body(index)
        pairs.append((f"{COLLISION}arm{index}_table", body, arm, geom, "table"))
        for other in range(arms.n):
            if other > index:
                name = f"{COLLISION}arm{index}_arm{other}"
                pairs.append((name, body, arm, body, arms.body(other)))
            if other != index:
                name = f"{COLLISION}arm{index}_{cube_name(other)}"
                pairs.append((name, body, arm, geom, cube_name(other)))
    add_contact_counters(spec, pairs)
