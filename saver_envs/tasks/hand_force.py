"""What the hands of arms press a limp person with."""

from __future__ import annotations

from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.scenes import NET_FORCE, Arms, add_contact_sensor, rotate
from saver_envs.simulation import Simulation
from saver_envs.tasks.layout import Part

#: In the frame of the base.
FORCE: Final = Part("gripper force", 3, "N", 0.005, limit=2000.0)
_PRESS: Final = "press_"


def add_force_sensors(spec: mujoco.MjSpec, arms: Arms) -> None:
    """Measure what arms press the person with.

    :param spec: with a person; gets the sensors.
    :param arms: of the scene.
    """
    for index in range(arms.n):
        name, kind = f"{_PRESS}{index}", mujoco.mjtObj.mjOBJ_XBODY
        add_contact_sensor(spec, name, arms.body(index), kind, "pelvis", NET_FORCE)


class HandForces:
    """What the arms of every simulation press with.

    :param simulation: of a scene with :func:`add_force_sensors`.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        model, arms = simulation.scene.model, range(simulation.scene.n_arms)
        addresses = [int(model.sensor(f"{_PRESS}{index}").adr[0]) for index in arms]
        self._columns = np.array(addresses)[:, None] + np.arange(3)

    def observed(self) -> dict[str, NDArray[Any]]:
        """Return the forces (n, arms, 3), N, as a part of the observation."""
        pressed = self._simulation.sensors.take(self._columns, 1)
        return {FORCE.name: rotate(self._simulation.scene.world_to_base, pressed)}
