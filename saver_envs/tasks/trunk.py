"""Where a limp person's thorax and pelvis are, how far they are turned, and how the head lies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.scenes import Arms
from saver_envs.simulation import ArmState, Simulation, cross, rotate_by_quaternion
from saver_envs.tasks.arm_and_object import OBJECT_PARTS
from saver_envs.tasks.hand_force import HandForces, add_force_sensors

Arrays = dict[str, NDArray[Any]]
FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class TrunkPart:
    """A part of the trunk that an arm turns.

    :param body: of the person.
    :param flank: geom of the side that comes up.
    :param along: where it is best pressed, along the world's y from the geom's middle, metres.
    """

    body: str
    flank: str
    along: float


#: Thorax and pelvis, arm by arm.
TRUNK: Final = (TrunkPart("torso", "back_0", -0.02), TrunkPart("pelvis", "pelvis_0", 0.0))
_BODIES: Final = (*(part.body for part in TRUNK), "head")
_KINDS: Final = {
    "position": mujoco.mjtSensor.mjSENS_FRAMEPOS,
    "quaternion": mujoco.mjtSensor.mjSENS_FRAMEQUAT,
    "velocity": mujoco.mjtSensor.mjSENS_FRAMELINVEL,
    "spin": mujoco.mjtSensor.mjSENS_FRAMEANGVEL,
}


def add_trunk_sensors(spec: mujoco.MjSpec, arms: Arms) -> None:
    """Measure where thorax, pelvis and head are, and how they move, and what hands press with."""
    add_force_sensors(spec, arms)
    for kind, sensor in _KINDS.items():
        for body in _BODIES:
            spec.add_sensor(
                name=f"trunk_{kind}_{body}",
                type=sensor,
                objtype=mujoco.mjtObj.mjOBJ_XBODY,
                objname=body,
            )


class Trunk:
    """Thorax and pelvis of the person of every simulation.

    :param simulation: of a scene with :func:`add_trunk_sensors`.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        scene = simulation.scene
        model = scene.model
        self._columns = {
            kind: np.array(
                [
                    int(sensor.adr[0]) + np.arange(int(sensor.dim[0]))
                    for sensor in (model.sensor(f"trunk_{kind}_{body}") for body in _BODIES)
                ]
            )
            for kind in _KINDS
        }
        ids = [model.geom(part.flank).id for part in TRUNK]
        #: (people, 2, 3) middle of the flanks in the frames of their bodies, and (people, 2, 1)
        #: their radii, metres.
        self._middle = np.stack([one.geom_pos[ids] for one in scene.models])
        self._radius = np.stack([one.geom_size[ids, :1] for one in scene.models])
        self._neck = model.site("joint_neck").id

    @staticmethod
    def memory(n: int) -> Arrays:
        """Return what has to be remembered of n people.

        :return: ``lay`` (n, 2, 2), where hips and neck were at the start, metres; ``looked``
            (n, 3), along the head in the frame of the thorax.
        """
        return {"lay": np.zeros((n, 2, 2)), "looked": np.zeros((n, 3))}

    def remember(self, memory: Arrays, rows: NDArray[np.intp]) -> None:
        """Remember how trunk and head lie in simulations ``rows`` (k,)."""
        memory["lay"][rows] = self._places()[rows]
        memory["looked"][rows] = self._along_head()[rows]

    def _read(self, kind: str) -> FloatArray:
        return self._simulation.sensors.take(self._columns[kind], 1)

    def _places(self) -> FloatArray:
        """Return hips and neck (n, 2, 2), level, metres."""
        hips = self._read("position")[:, 1]
        neck = self._simulation.site_position[:, self._neck]
        return np.stack([hips, neck], axis=1)[..., :2]

    def _along_head(self) -> FloatArray:
        """Return the head's long axis (n, 3) in the frame of the thorax."""
        turned = self._read("quaternion")
        axis = rotate_by_quaternion(turned[:, 2], np.array([1.0, 0.0, 0.0]))
        return rotate_by_quaternion(turned[:, 0] * [1.0, -1.0, -1.0, -1.0], axis)

    def turns(self) -> FloatArray:
        """Return the turns (n, 2) of thorax and pelvis about the long axis, rad; 0 on the back."""
        w, x, y, z = np.moveaxis(self._read("quaternion")[:, :2], -1, 0)
        return np.arctan2(2 * (y * z + w * x), 1 - 2 * (x * x + y * y))

    def observed(self, memory: Arrays, arms: ArmState) -> Arrays:
        """Return parts of the observation: of each arm's part of the trunk, and of the person.

        :param memory: see :meth:`memory`; and ``who`` (n,).
        :param arms: the arms' state.
        """
        quaternion, who = self._read("quaternion")[:, :2], memory["who"]
        lever = rotate_by_quaternion(quaternion, self._middle[who])
        spin = self._read("spin")[:, :2]
        scene = self._simulation.scene
        place = scene.to_bases(self._read("position")[:, :2] + lever)
        values = (
            place,
            place - arms.tool_position,
            np.where(quaternion[..., :1] < 0, -quaternion, quaternion),
            self._read("velocity")[:, :2] + cross(spin, lever),
            spin,
        )
        seen = {part.name: value for part, value in zip(OBJECT_PARTS, values, strict=True)}
        readings = self.readings(memory)
        forces = self._simulation.keep(HandForces).observed()
        return (
            seen
            | forces
            | {
                "object radius": self._radius[who],
                "head bend": readings["head"][:, None],
                "trunk way": readings["way"][:, None],
            }
        )

    def readings(self, memory: Arrays) -> Arrays:
        """Return ``twist`` and ``head`` (rad) and ``way`` (m), (n,) each.

        :param memory: see :meth:`memory`.
        """
        turns = self.turns()
        cosine = np.sum(self._along_head() * memory["looked"], axis=-1)
        away = self._places() - memory["lay"]
        return {
            "twist": np.abs(turns[:, 0] - turns[:, 1]),
            "head": np.arccos(np.clip(cosine, -1.0, 1.0)),
            "way": np.sqrt((away * away).sum(axis=-1)).max(axis=-1),
        }
