"""The task that the loop is made for, and its limits. No other module of the loop knows either."""

from __future__ import annotations

from typing import Any, Final

from saver_envs.registration import CASUALTY_ID, row_of

#: The environment that provides scenes, starts and the scripted policy.
ENV_ID: Final = CASUALTY_ID
#: Its task: horizon, success threshold, and the limits of what the torso may be put through.
TASK: Final[Any] = row_of(ENV_ID).task
#: The robot whose finger readings the shipped push policies were trained with, and the height of
#: the centres of the cubes that they pushed (m).
TRAINED_ON: Final = "jaco"
CUBE_HEIGHT: Final = 0.028


def trained_on_people(env_id: str) -> bool:
    """Return whether the objects of an environment are a person's wrists.

    :param env_id: a registered id.
    :raises ValueError: for an unknown id.
    """
    return issubclass(row_of(env_id).task, TASK)
