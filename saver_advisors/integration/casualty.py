"""The task that the loop is made for, and its limits. No other module of the loop knows either."""

from __future__ import annotations

from typing import Any, Final

from saver_envs.registration import CASUALTY_ID, TWO_ARM_ID, row_of

#: The environment that provides scenes, starts and the scripted policy.
ENV_ID: Final = CASUALTY_ID
#: Its task: horizon, success threshold, and the limits of force and displacement at the torso.
TASK: Final[Any] = row_of(ENV_ID).task
#: The environment that the shipped push policies for two arms were trained in: the robot whose
#: finger readings they expect, and the height of the centres of the cubes (m).
_CUBES: Final[Any] = row_of(TWO_ARM_ID)
TRAINED_ON: Final[str] = _CUBES.robot
CUBE_HEIGHT: Final[float] = _CUBES.task.object_size / 2
