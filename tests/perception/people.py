"""Random people for the tests: joints in a picture, none of them hidden."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from saver_envs.perception.skeleton import JOINTS, LIMBS

#: Lengths of limbs in units of the distance from neck to hip, and rest directions (degrees from
#: straight down, towards the picture's right).
_LENGTH = {"head": 0.5, "collar": 0.4, "upper_arm": 0.6, "forearm": 0.55, "trunk": 1.0}
_LENGTH |= {"thigh": 0.85, "shank": 0.8}
_ANGLE = {"head": 180.0, "collar": 80.0, "upper_arm": 30.0, "forearm": 20.0, "trunk": 15.0}
_ANGLE |= {"thigh": 5.0, "shank": 0.0}
#: How far a limb may turn to either side of its rest direction (degrees).
_PLAY = {"head": 20.0, "collar": 8.0, "upper_arm": 60.0, "forearm": 60.0, "trunk": 4.0}
_PLAY |= {"thigh": 25.0, "shank": 25.0}


def person(
    random: np.random.Generator, neck: tuple[float, float], torso: float
) -> NDArray[np.float64]:
    """Return joints (14, 2), pixels, of an upright person that faces the camera."""
    joints = np.full((len(JOINTS), 2), np.nan)
    joints[0] = neck
    for limb in LIMBS:
        kind = limb.name.removeprefix("left_").removeprefix("right_")
        side = -1.0 if limb.name.startswith("right_") else 1.0
        angle = math.radians(side * _ANGLE[kind] + random.uniform(-1, 1) * _PLAY[kind])
        step = torso * _LENGTH[kind] * np.array([math.sin(angle), math.cos(angle)])
        joints[limb.distal] = joints[limb.proximal] + step
    return joints
