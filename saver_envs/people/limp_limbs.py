"""The arms or legs of a limp person, each beside the robot's arm that handles it."""

from __future__ import annotations

from typing import Any, ClassVar, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.people.bench import SIDE_OF_ARM
from saver_envs.people.limp_people import LimpPeople
from saver_envs.people.manikin import SIDES
from saver_envs.simulation import ObjectState, Simulation

#: Reading -> kind of sensor, and whether it is that of the outermost joint's site; else of the
#: segment that ends there.
_KINDS: Final = {
    "quaternion": (mujoco.mjtSensor.mjSENS_FRAMEQUAT, False),
    "spin": (mujoco.mjtSensor.mjSENS_FRAMEANGVEL, False),
    "velocity": (mujoco.mjtSensor.mjSENS_FRAMELINVEL, True),
}


class LimpLimbs:
    """Limbs of one kind, of the person of every simulation; arrays lead with (n, arms).

    :param simulation: of a scene with two robots' arms and :meth:`add_sensors`.
    """

    #: What the limbs are, in names of sensors.
    limb: ClassVar[str]
    #: Joints from the trunk outwards; the middle one is a hinge.
    joints: ClassVar[tuple[str, str, str]]
    #: Segment that ends at the outermost joint.
    segment: ClassVar[str]
    #: Of the limbs at the robot's arms 0 and 1.
    sides: ClassVar[tuple[str, str]]

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        model = simulation.scene.model
        self._sites = {
            joint: np.array([model.site(f"joint_{side}_{joint}").id for side in self.sides])
            for joint in self.joints
        }
        self._sensors = {reading: self._columns(model, reading) for reading in _KINDS}

    @classmethod
    def add_sensors(cls, spec: mujoco.MjSpec) -> None:
        """Measure how the outer segments lie and move, in the world's frame.

        :param spec: with a person; gets the sensors.
        """
        for side in cls.sides:
            for reading, (kind, of_site) in _KINDS.items():
                spec.add_sensor(
                    name=f"{cls.limb}_{reading}_{side}",
                    type=kind,
                    objtype=mujoco.mjtObj.mjOBJ_SITE if of_site else mujoco.mjtObj.mjOBJ_XBODY,
                    objname=f"joint_{side}_{cls.joints[2]}" if of_site else f"{side}_{cls.segment}",
                )

    def places(self, joint: str, other: bool = False) -> NDArray[np.float64]:
        """Return where the centres of a joint of :attr:`joints` are (n, arms, 3), in m.

        Each is in the base frame of the robot's arm at its side.

        :param joint: which.
        :param other: of the limbs at the other arm instead.
        """
        sites = self._sites[joint][::-1] if other else self._sites[joint]
        return self._simulation.scene.to_bases(self._simulation.site_position.take(sites, 1))

    def bends(self) -> NDArray[np.float64]:
        """Return the bends of the middle joints (n, arms, 1), rad."""
        names = [f"{side}_{self.joints[1]}" for side in self.sides]
        return self._simulation.keep(LimpPeople).angles(*names)[..., None]

    def ends(self) -> ObjectState:
        """Return the outermost joints, turned as the segments are; bases are parallel to the world.

        Velocities are those in the world's frame.
        """
        read = {name: self._simulation.sensors.take(at, 1) for name, at in self._sensors.items()}
        turned, end = read["quaternion"], self.joints[2]
        return ObjectState(
            position=self.places(end),
            quaternion=np.where(turned[..., :1] < 0, -turned, turned),
            linear_velocity=read["velocity"],
            angular_velocity=read["spin"],
            world_position=self._simulation.site_position.take(self._sites[end], 1),
        )

    def _columns(self, model: Any, reading: str) -> NDArray[np.intp]:
        """Return the addresses (arms, numbers) of a reading in ``sensordata``."""
        sensors = [model.sensor(f"{self.limb}_{reading}_{side}") for side in self.sides]
        return np.array([int(one.adr[0]) + np.arange(int(one.dim[0])) for one in sensors])


class LimpArms(LimpLimbs):
    """The arms of a person whose head is at the robots."""

    limb: ClassVar[str] = "arm"
    joints: ClassVar[tuple[str, str, str]] = ("shoulder", "elbow", "wrist")
    segment: ClassVar[str] = "forearm"
    sides: ClassVar[tuple[str, str]] = SIDE_OF_ARM


class LimpLegs(LimpLimbs):
    """The legs of a person whose feet are at the robots."""

    limb: ClassVar[str] = "leg"
    joints: ClassVar[tuple[str, str, str]] = ("hip", "knee", "ankle")
    segment: ClassVar[str] = "shank"
    sides: ClassVar[tuple[str, str]] = SIDES
