"""The arms of a limp person, each beside the robot's arm that handles it."""

from __future__ import annotations

from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.people.bench import SIDE_OF_ARM
from saver_envs.people.limp_people import LimpPeople
from saver_envs.simulation import ObjectState, Simulation

#: Joints of an arm, from the trunk outwards.
ARM_JOINTS: Final = ("shoulder", "elbow", "wrist")
#: Reading -> kind of sensor, and whether it is that of the wrist's site; else of the forearm.
_KINDS: Final = {
    "quaternion": (mujoco.mjtSensor.mjSENS_FRAMEQUAT, False),
    "spin": (mujoco.mjtSensor.mjSENS_FRAMEANGVEL, False),
    "velocity": (mujoco.mjtSensor.mjSENS_FRAMELINVEL, True),
}


def add_arm_sensors(spec: mujoco.MjSpec) -> None:
    """Measure how forearms lie and move, in the world's frame.

    :param spec: with a person; gets the sensors.
    """
    for side in SIDE_OF_ARM:
        for reading, (kind, of_site) in _KINDS.items():
            spec.add_sensor(
                name=f"arm_{reading}_{side}",
                type=kind,
                objtype=mujoco.mjtObj.mjOBJ_SITE if of_site else mujoco.mjtObj.mjOBJ_XBODY,
                objname=f"joint_{side}_wrist" if of_site else f"{side}_forearm",
            )


class LimpArms:
    """The arms of the person of every simulation; arrays lead with (n, arms).

    :param simulation: of a scene with two robots' arms and :func:`add_arm_sensors`.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        model = simulation.scene.model
        self._sites = {
            joint: np.array([model.site(f"joint_{side}_{joint}").id for side in SIDE_OF_ARM])
            for joint in ARM_JOINTS
        }
        self._sensors = {reading: _columns(model, reading) for reading in _KINDS}

    def places(self, joint: str) -> NDArray[np.float64]:
        """Return where the centres of a joint of :data:`ARM_JOINTS` are (n, arms, 3), in m.

        Each is in the base frame of the robot's arm at its side.
        """
        sites = self._simulation.site_position.take(self._sites[joint], 1)
        return self._simulation.scene.to_bases(sites)

    def bends(self) -> NDArray[np.float64]:
        """Return the bends of the elbows (n, arms, 1), rad."""
        names = [f"{side}_elbow" for side in SIDE_OF_ARM]
        return self._simulation.keep(LimpPeople).angles(*names)[..., None]

    def wrists(self) -> ObjectState:
        """Return the wrists, turned as the forearms are; the bases are parallel to the world."""
        read = {name: self._simulation.sensors.take(at, 1) for name, at in self._sensors.items()}
        turned = read["quaternion"]
        return ObjectState(
            position=self.places("wrist"),
            quaternion=np.where(turned[..., :1] < 0, -turned, turned),
            linear_velocity=read["velocity"],
            angular_velocity=read["spin"],
            world_position=self._simulation.site_position.take(self._sites["wrist"], 1),
        )


def _columns(model: Any, reading: str) -> NDArray[np.intp]:
    """Return the addresses (arms, numbers) of a reading in ``sensordata``."""
    sensors = [model.sensor(f"arm_{reading}_{side}") for side in SIDE_OF_ARM]
    return np.array([int(one.adr[0]) + np.arange(int(one.dim[0])) for one in sensors])
