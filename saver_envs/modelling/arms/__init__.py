"""The arms that can be modelled, one file each, and a table of their names."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Final, Literal

from saver_envs.modelling.arms import fetch, jaco, mico
from saver_envs.modelling.arms.description import KinematicArm

#: Inverse kinematics or inverse dynamics.
Task = Literal["ik", "id"]
TASK_NAMES: Final[Mapping[Task, str]] = {"ik": "inverse kinematics", "id": "inverse dynamics"}

_BUILDERS = {"mico": mico.arm, "fetch": fetch.arm, "jaco": jaco.arm}
ARMS = tuple(_BUILDERS)


@cache
def arm_named(name: str) -> KinematicArm:
    """Return an arm.

    :param name: lower-case name.
    :raises ValueError: for a name that is not in ``ARMS``.
    """
    if name not in _BUILDERS:
        raise ValueError(f"robot={name!r}: must be one of {', '.join(ARMS)}")
    return _BUILDERS[name]()


def arms_with_twins() -> list[str]:
    """Return the names of the arms of which a twin and data sets exist."""
    return [name for name in ARMS if arm_named(name).twin is not None]
