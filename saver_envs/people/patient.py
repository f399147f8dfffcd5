"""The person in n simulations: placement at resets, readings for observations and costs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.people.bench import HIPS, person_addresses
from saver_envs.people.stretcher import STRETCHER
from saver_envs.people.variants import SceneVariants
from saver_envs.scenes import Scene
from saver_envs.simulation import ObjectState, Simulation, cross

Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class People:
    """Who lies on the bench and how, one row for each of k episodes.

    :param body: (k,) which of :data:`saver_envs.people.bodies.BODIES`.
    :param hips: (k, 2) middle between the hip joints, world frame, metres.
    :param yaw: (k,) turn of the trunk, radians; at 0 the feet point along +x.
    :param shoulder: (k, arms, 4) quaternions of the shoulders, of arms in the scene's order.
    :param elbow: (k, arms) angles of the elbows, radians.
    :param friction: (k,) sliding friction of arms and hands with what they touch.
    :param stiffness: (k,) factor of the friction and the damping in the joints of the arms.
    :param mass: (k,) factor of the masses of all body parts.
    """

    body: NDArray[np.intp]
    hips: NDArray[np.float64]
    yaw: NDArray[np.float64]
    shoulder: NDArray[np.float64]
    elbow: NDArray[np.float64]
    friction: NDArray[np.float64]
    stiffness: NDArray[np.float64]
    mass: NDArray[np.float64]

    @staticmethod
    def default(n: int) -> People:
        """Return n times the first body, as it is compiled."""
        return People(
            body=np.zeros(n, dtype=np.intp),
            hips=np.tile(HIPS[:2], (n, 1)).astype(np.float64),
            yaw=np.zeros(n),
            shoulder=np.tile([1.0, 0.0, 0.0, 0.0], (n, 2, 1)),
            elbow=np.zeros((n, 2)),
            friction=np.full(n, 0.4),
            stiffness=np.ones(n),
            mass=np.ones(n),
        )


def joined(people: list[People]) -> People:
    """Concatenate the rows of several."""
    names = vars(people[0])
    return People(
        **{name: np.concatenate([getattr(one, name) for one in people]) for name in names}
    )


def person_memory(n: int) -> Arrays:
    """Return what has to be remembered of n people: who they are, and where they were laid down.

    :return: the fields of :class:`People`, and ``hips_before`` and ``neck_before`` (n, 2), metres.
    """
    before = {"hips_before": np.zeros((n, 2)), "neck_before": np.zeros((n, 2))}
    return vars(People.default(n)) | before


def people_in(memory: Arrays) -> People:
    """Return who lies there, as views of the memory."""
    return People(**{name: memory[name] for name in People.__annotations__})


class Patient:
    """The person of every simulation.

    :param simulation: of a scene with a person; its models get that person's body.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._scene: Scene = simulation.scene
        self._where = person_addresses(simulation.scene)
        self._variants = SceneVariants(simulation, ("geom_friction", "dof_damping"))
        self._bodies, self._fields = self._variants.values, self._variants.fields
        self._damping = self._scene.model.dof_damping[self._where.limb_dofs]
        self._parts = np.setdiff1d(np.arange(1, self._scene.model.nbody), simulation.arm_bodies)

    def place(
        self,
        memory: Arrays,
        rows: NDArray[np.intp],
        people: People,
        joints: NDArray[np.float64],
    ) -> None:
        """Put people and arms of simulations ``rows`` (k,) at rest, and remember them.

        :param memory: see :func:`person_memory`.
        :param rows: which simulations.
        :param people: k of them.
        :param joints: (k, arms, dof) of the robots' arms, radians.
        """
        where, simulation = self._where, self._simulation
        self.give_bodies(rows, people)
        simulation.reset(rows, joints, np.zeros((len(rows), self._scene.n_arms, 0)))
        shift = people.hips - HIPS[:2] + self._turned_off(people)
        simulation.qpos[rows[:, None], where.trunk_qpos] = np.column_stack([shift, people.yaw])
        simulation.qpos[rows[:, None, None], where.shoulder_qpos] = people.shoulder
        simulation.qpos[rows[:, None], where.elbow_qpos] = people.elbow
        simulation.refresh(rows)
        for name, values in vars(people).items():
            memory[name][rows] = values
        sites = simulation.site_position
        memory["hips_before"][rows] = sites[rows[:, None], where.hip_site, :2].mean(axis=1)
        memory["neck_before"][rows] = sites[rows, where.neck_site, :2]

    def _turned_off(self, people: People) -> NDArray[np.float64]:
        """Return by how much (k, 2) the turn of the pelvis moves the middle of the hips, metres.

        The pelvis turns about its own joint, which is some millimetres away.
        """
        pelvis = self._scene.model.body("pelvis").id
        lever = self._bodies["body_pos"][people.body, pelvis, :2] - HIPS[:2]
        return turned(lever, people.yaw) - lever

    def give_bodies(self, rows: NDArray[np.intp], people: People) -> None:
        """Give the models of simulations ``rows`` the bodies of ``people``."""
        where, fields = self._where, self._fields
        self._variants.write(rows, people.body)
        dofs, geoms = where.limb_dofs, where.limb_geoms
        fields["dof_frictionloss"][rows[:, None], dofs] *= people.stiffness[:, None]
        fields["dof_damping"][rows[:, None], dofs] = self._damping * people.stiffness[:, None]
        fields["geom_friction"][rows[:, None], geoms, 0] = people.friction[:, None]
        others = people.mass != 1
        if others.any():
            self._give_masses(rows[others], people.body[others], people.mass[others])

    def _give_masses(
        self, rows: NDArray[np.intp], body: NDArray[np.intp], factor: NDArray[np.float64]
    ) -> None:
        """Multiply the masses of bodies in simulations ``rows``, all (k,)."""
        parts, every, fields = self._parts, rows[:, None], self._fields
        fields["body_mass"][every, parts] *= factor[:, None]
        fields["body_inertia"][every, parts] *= factor[:, None, None]
        self._simulation.update_constants(rows)
        # Those of the compiled bodies, which have parts that were fused.
        weights = self._bodies["body_invweight0"][body[:, None], parts]
        fields["body_invweight0"][every, parts] = weights / factor[:, None, None]

    def wrists(self) -> ObjectState:
        """Return the state of the wrists, which take the place of cubes.

        A wrist's x axis points from the elbow to the wrist, and its y axis is level: as a skeleton
        gives them. Its angular velocity is that of the forearm, across the forearm.
        """
        where = self._where
        sites, sensors = self._simulation.site_position, self._simulation.sensors
        wrist = sites.take(where.wrist_site, 1)
        along = wrist - sites.take(where.elbow_site, 1)
        velocities = sensors.take(where.velocity_sensor, 1)
        velocity = velocities[:, :, 0]
        squared = (along * along).sum(axis=-1, keepdims=True)
        angular = cross(along, velocity - velocities[:, :, 1]) / squared
        # The bases are not rotated: their frames differ from the world's by a translation.
        position = wrist - self._scene.base_position
        return ObjectState(position, heading(along), velocity, angular, wrist)

    def hips(self) -> NDArray[np.float64]:
        """Return where the hip joints are, (n, arms, 3), world frame, metres."""
        return self._simulation.site_position.take(self._where.hip_site, 1)

    def readings(self, memory: Arrays) -> dict[str, NDArray[np.float64]]:
        """Return the load on the torso, (n,) each.

        ``torso_force``: sum of the normal forces on torso and pelvis, of the robots' arms and of
        the person's own that they push, newtons; the highest of an action's samples.
        ``torso_displacement``: how far the middle of the hips or the neck, whichever has moved
        more, is from where it was at the reset, metres, horizontally.
        """
        where, simulation = self._where, self._simulation
        force = simulation.peaks.take(where.force_sensor, 1).sum(axis=-1)
        sites = simulation.site_position
        hips = sites.take(where.hip_site, 1)[..., :2].mean(axis=1) - memory["hips_before"]
        neck = sites[:, where.neck_site, :2] - memory["neck_before"]
        displacement = np.sqrt(np.maximum((hips * hips).sum(axis=-1), (neck * neck).sum(axis=-1)))
        return {"torso_force": force, "torso_displacement": displacement}


def turned(points: NDArray[np.float64], yaw: NDArray[np.float64] | float) -> NDArray[np.float64]:
    """Return points (k, 2) turned about the origin by ``yaw`` (k,) or of all, radians."""
    x, y = points.T
    cosine, sine = np.cos(yaw), np.sin(yaw)
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)


def place_stretcher(model: mujoco.MjModel, people: People, row: int) -> None:
    """Move the stretcher of a drawing model to where the person of ``row`` was laid down."""
    stretcher, yaw = model.body(STRETCHER).id, people.yaw[row] / 2
    model.body_pos[stretcher, :2] = people.hips[row]
    model.body_quat[stretcher] = (np.cos(yaw), 0, 0, np.sin(yaw))


def heading(along: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return quaternions (..., 4), w >= 0, whose x axis is ``along`` and whose y axis is level."""
    level = np.hypot(along[..., 0], along[..., 1])
    yaw = np.arctan2(along[..., 1], along[..., 0]) / 2
    pitch = np.arctan2(-along[..., 2], level) / 2
    cy, sy, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    # Half of the yaw is within a quarter turn, so w is never negative.
    return np.stack([cy * cp, -sy * sp, cy * sp, sy * cp], axis=-1)
