"""Where the joints of a limp person's limbs are, arm by arm, and how fast they move."""

from __future__ import annotations

from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.people.manikin import SIDES
from saver_envs.simulation import Simulation
from saver_envs.tasks.arm_and_object import LINEAR_VELOCITY_SCALE
from saver_envs.tasks.layout import Part

FloatArray = NDArray[np.float64]

#: Joints of a side that arms see.
LIMB_JOINTS: Final = ("ankle", "knee", "wrist", "elbow")
POSITIONS: Final = tuple(Part(f"{joint} position", 3, "m") for joint in LIMB_JOINTS)
VELOCITIES: Final = tuple(
    Part(f"{joint} velocity", 3, "m/s", LINEAR_VELOCITY_SCALE) for joint in LIMB_JOINTS
)
_ARM: Final = [LIMB_JOINTS.index("wrist"), LIMB_JOINTS.index("elbow")]
_SENSOR: Final = "limb_velocity_"


def add_limb_sensors(spec: mujoco.MjSpec) -> None:
    """Measure the velocities of the joints of both sides.

    :param spec: with a person; gets the sensors.
    """
    for side in SIDES:
        for joint in LIMB_JOINTS:
            spec.add_sensor(
                name=f"{_SENSOR}{side}_{joint}",
                type=mujoco.mjtSensor.mjSENS_FRAMELINVEL,
                objtype=mujoco.mjtObj.mjOBJ_SITE,
                objname=f"joint_{side}_{joint}",
            )


class Limbs:
    """Joints of the limbs of the person of every simulation: of the left side for arm 0.

    :param simulation: of a scene with two arms and :func:`add_limb_sensors`.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        model = simulation.scene.model
        names = [[f"{side}_{joint}" for joint in LIMB_JOINTS] for side in SIDES]
        self._sites = np.array([[model.site(f"joint_{one}").id for one in row] for row in names])
        starts = [[model.sensor(f"{_SENSOR}{one}").adr[0] for one in row] for row in names]
        self._columns = np.array(starts)[..., None] + np.arange(3)

    def observed(self) -> dict[str, FloatArray]:
        """Return positions (m) and velocities (m/s) of the joints, (n, arms, 3) each, by part."""
        scene = self._simulation.scene
        places = self._simulation.site_position[:, self._sites]
        speeds = self._simulation.sensors.take(self._columns, 1)
        seen: dict[str, FloatArray] = {}
        for index, (place, speed) in enumerate(zip(POSITIONS, VELOCITIES, strict=True)):
            seen[place.name] = scene.to_bases(places[:, :, index])
            seen[speed.name] = speeds[:, :, index]
        return seen

    def ankles(self) -> FloatArray:
        """Return where ankles are, (n, arms, 3), metres, in the world."""
        return self._simulation.site_position[:, self._sites[:, LIMB_JOINTS.index("ankle")]]

    def arms(self) -> FloatArray:
        """Return where wrists and elbows are, (n, arms, 2, 3), metres, in the world."""
        return self._simulation.site_position[:, self._sites[:, _ARM]]
