"""Persons on a bed, and what the tests measure of them."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.people.bed import Bed
from saver_envs.people.limp_joints import PASSIVE_JOINTS, joint_names
from saver_envs.people.limp_person import LimpPerson
from saver_envs.people.lying import LyingPosture, LyingWorld
from saver_envs.world import TIMESTEP

WIDE = Bed(width=1.6)
MAN = LimpPerson("male", 1.76, 24.0)
WOMAN = LimpPerson("female", 1.60, 27.0)


def put(world: LyingWorld, posture: LyingPosture, lift: float = 0.0) -> None:
    """Put the person into a posture, so much higher than the compiled one (m), without velocity."""
    mujoco.mj_resetData(world.model, world.data)
    world.data.qpos[world.layout.qpos] = world.layout.pose(posture)
    world.data.qpos[world.layout.root_qpos[2]] += lift
    mujoco.mj_forward(world.model, world.data)


def run(world: LyingWorld, seconds: float) -> None:
    """Simulate."""
    mujoco.mj_step(world.model, world.data, round(seconds / TIMESTEP))
    mujoco.mj_forward(world.model, world.data)


def beyond_ranges(world: LyingWorld) -> dict[str, float]:
    """Return by how much each joint is beyond its range, degrees; negative within."""
    found = {}
    for joint in PASSIVE_JOINTS:
        for name in joint_names(joint):
            value = world.data.qpos[world.layout.joint_qpos[name]]
            turn = 2 * np.arccos(min(abs(value[0]), 1.0)) if len(value) == 4 else value[0]
            low, high = np.radians(joint.range)
            found[name] = float(np.degrees(max(low - turn, turn - high)))
    return found


def angle(world: LyingWorld, name: str) -> float:
    """Return the angle of a hinge, degrees."""
    return float(np.degrees(world.data.qpos[world.layout.joint_qpos[name][0]]))


def site(world: LyingWorld, name: str) -> NDArray[np.float64]:
    """Return where a joint of the skeleton is, metres."""
    return world.data.site(f"joint_{name}").xpos.copy()


def roll_of(world: LyingWorld, body: str) -> float:
    """Return the turn of the trunk about its long axis, degrees; 90 on the left side."""
    matrix = world.data.body(body).xmat.reshape(3, 3)
    return float(np.degrees(np.arctan2(-matrix[2, 1], matrix[2, 2])))
