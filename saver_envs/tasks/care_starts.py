"""Starts with a limp person at rest on a bed, settled beforehand.

A person takes seconds to come to rest, so that the postures of a task are settled once, by
``python tools/settle_starts.py ID``, and come with the package: some of every person, at the usual
place. A start moves one of them over the bed, which is level.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.people.bed import Bed
from saver_envs.people.limp_people import PEOPLE
from saver_envs.people.lying import LyingWorld, PersonLayout
from saver_envs.robots.drives import product
from saver_envs.scenes import Scene
from saver_envs.tasks.contract import Start

FloatArray = NDArray[np.float64]

#: Where the settled postures are.
FOLDER: Final = Path(__file__).parent / "settled"


@dataclass(frozen=True)
class CareStart(Start):
    """A start with a person on a bed; a task's own class adds its goal.

    :param who: which of :data:`saver_envs.people.limp_people.PEOPLE`.
    :param pose: (35,) the person's numbers, see :class:`saver_envs.people.lying.PersonLayout`.
    :param stiffness: factor of the person's joints.
    :param friction: sliding friction of clothes and skin.
    :param bed_friction: sliding friction of the person and the bed.
    """

    who: int
    pose: FloatArray
    stiffness: float
    friction: float
    bed_friction: float


@lru_cache(maxsize=8)
def settled(name: str) -> FloatArray:
    """Return the settled postures of a task, (people, postures, 35).

    :param name: of the task.
    :raises FileNotFoundError: where there are none; the message names the command.
    """
    path = settled_path(name)
    if not path.is_file():
        raise FileNotFoundError(
            f"{path} does not exist: `python tools/settle_starts.py ID` settles the starts of an id"
        )
    return np.load(path, allow_pickle=False).astype(np.float64)


def settled_path(name: str) -> Path:
    """Return the file of the settled postures of the task of a name."""
    return FOLDER / f"{name.replace(' ', '_')}.npy"


@lru_cache(maxsize=len(PEOPLE))
def alone(who: int, bed: Bed) -> LyingWorld:
    """Return a person alone on a bed, to settle.

    :param who: which of :data:`saver_envs.people.limp_people.PEOPLE`.
    :param bed: on what.
    """
    return LyingWorld(PEOPLE[who], bed)


def moved(pose: FloatArray, centre: Sequence[float] | FloatArray, shift: FloatArray) -> FloatArray:
    """Return a pose (35,) that is moved over the bed.

    :param pose: of the person, at the usual place.
    :param centre: of the bed, about which the person is turned, metres.
    :param shift: (3,) along x and y, metres, and about the vertical, radians.
    """
    x, y, turn = shift
    cosine, sine = math.cos(turn), math.sin(turn)
    arm = pose[:2] - centre[:2]
    result = pose.copy()
    result[:2] = np.array([cosine, sine]) * arm[0] + np.array([-sine, cosine]) * arm[1]
    result[:2] += np.add(centre[:2], (x, y))
    half = np.array([math.cos(turn / 2), 0.0, 0.0, math.sin(turn / 2)])
    result[3:7] = product(half, pose[3:7])
    return result


class PosedPeople:
    """Where the parts of a person in a pose are, without simulating: for samplers of starts.

    :param scene: whose variants are the persons.
    """

    def __init__(self, scene: Scene) -> None:
        self._models = scene.models
        self._layout = PersonLayout(scene.model)
        self._data: dict[int, mujoco.MjData] = {}

    def posed(self, who: int, pose: FloatArray) -> mujoco.MjData:
        """Return data with the places of bodies, geoms and sites; the next call overwrites it.

        :param who: which of :data:`saver_envs.people.limp_people.PEOPLE`.
        :param pose: (35,).
        """
        model = self._models[who]
        if who not in self._data:
            self._data[who] = mujoco.MjData(model)
        data = self._data[who]
        data.qpos[self._layout.qpos] = pose
        mujoco.mj_kinematics(model, data)
        return data


#: The people of a scene, set up once.
posed_people = lru_cache(maxsize=8)(PosedPeople)
