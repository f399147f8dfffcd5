"""Cubes: one per arm, with a target of the same colour."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from saver_envs.scenes import (
    ARM_COLOURS,
    COLLISION,
    OBJECT_BIT,
    Arms,
    Content,
    add_contact_sensor,
    add_target,
)
from saver_envs.world import TABLE_BIT

#: Edges of cubes (m) that these hands can push within their reach.
CUBE_SIZE = (0.04, 0.12)
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
    :param friction: sliding friction with the table and the hands, dimensionless.
    :param damping: viscous drag on the cube's motion, N s/m; 0 for free sliding. Its rotation is
        damped, in N m s/rad, as if the drag acted on one face: by this times the mean squared
        distance of the face's points from its centre, a sixth of the squared edge.
    """

    n: int
    size: float = 0.056
    mass: float = 0.2
    friction: float = 0.5
    damping: float = 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the bodies, and of their geoms."""
        return tuple(cube_name(index) for index in range(self.n))

    def build(self, spec: mujoco.MjSpec, arms: Arms, variant: int, decorated: bool) -> None:
        """Add cubes, targets, and sensors that count collisions."""
        for index, name in enumerate(self.names):
            place = (_COMPILED_X, 0.1 * index, self.size / 2)
            body = spec.worldbody.add_body(name=name, pos=place)
            body.add_freejoint(name=f"{name}_joint")
            if self.damping:
                body.joints[0].damping = (self.damping, 0, 0)
            body.add_geom(
                name=name,
                type=mujoco.mjtGeom.mjGEOM_BOX,
                size=(self.size / 2,) * 3,
                mass=self.mass,
                friction=(self.friction, 0.02, 0.001),
                condim=3,
                contype=OBJECT_BIT,
                conaffinity=TABLE_BIT | OBJECT_BIT,
                rgba=(*ARM_COLOURS[index], 1),
            )
            add_target(spec, index, self.size / 2, place)
        _add_collision_counters(spec, arms)

    def compiled(self, model: mujoco.MjModel) -> None:
        """Set the damping of the cubes' rotation.

        A free joint has one damping for all its motions, which would block rotation.
        """
        for name in self.names:
            turning = model.joint(f"{name}_joint").dofadr[0] + np.arange(3, 6)
            model.dof_damping[turning] = self.damping * self.size**2 / 6


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
