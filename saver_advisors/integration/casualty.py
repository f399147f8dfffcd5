"""The task and robot that the loop is made for. No other module of the loop names either."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from saver_envs.registration import row_of
from saver_envs.tasks.base import SUCCESS_THRESHOLD
from saver_envs.tasks.wrist_push import DISPLACEMENT_LIMIT, FORCE_LIMIT, HORIZON, STANDOFF

#: The environment that provides scenes, starts and the scripted policy.
ENV_ID: Final = "WristPush-v0"
#: The robot whose finger readings the shipped push policies were trained with, and the height of
#: the centres of the cubes that they pushed (m).
TRAINED_ON: Final = "jaco"
CUBE_HEIGHT: Final = 0.028


@dataclass(frozen=True)
class TaskLimits:
    """Hold the numbers of a task that the loop and its metrics use.

    :param torso_force: force on the torso above which a trial counts as harmful, newtons.
    :param torso_displacement: likewise for the torso's displacement, metres.
    :param standoff: lateral distance of a target from its hip joint, metres.
    :param horizon: actions in a trial.
    :param success_threshold: distance from a target that counts as reached, metres.
    """

    torso_force: float
    torso_displacement: float
    standoff: float
    horizon: int
    success_threshold: float


LIMITS: Final = TaskLimits(
    torso_force=FORCE_LIMIT,
    torso_displacement=DISPLACEMENT_LIMIT,
    standoff=STANDOFF,
    horizon=HORIZON,
    success_threshold=SUCCESS_THRESHOLD,
)


def trained_on_people(env_id: str) -> bool:
    """Return whether the objects of an environment are a person's wrists.

    :param env_id: a registered id.
    :raises ValueError: for an unknown id.
    """
    return row_of(env_id).task.moves_person
