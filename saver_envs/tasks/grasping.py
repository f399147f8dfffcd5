"""How a closed hand holds a cube: simulated once, for starts with a cube in hand."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.reachability import reachability_map
from saver_envs.robots.description import Fingers, Robot
from saver_envs.scenes import Arms, compose, free_bodies
from saver_envs.tasks.cubes import CubeTask

_HAND_POSITION = (0.45, 0.0, 0.20)  # m, base frame: free of the table
_SETTLING_STEPS = 500  # 1 s


@dataclass(frozen=True)
class Grasp:
    """A cube in the closed hand, in the tool's frame.

    :param finger_position: (fingers,) finger angles, radians.
    :param object_offset: (3,) cube centre relative to the tool, metres.
    :param object_quaternion: (4,) cube orientation, w first.
    """

    finger_position: NDArray[np.float64]
    object_offset: NDArray[np.float64]
    object_quaternion: NDArray[np.float64]


@lru_cache(maxsize=64)
def settled_grasp(robot: Robot, cube: CubeTask) -> Grasp:
    """Close the hand on a weightless cube between its fingers and read where both come to rest.

    :param robot: an arm with actuated fingers.
    :param cube: a task with one cube.
    :return: the grasp.
    :raises RuntimeError: when the hand cannot hold such a cube.
    """
    scene = compose(Arms(robot, 1, Fingers.ACTUATED), cube)
    address = free_bodies(scene, cube.resting).qpos[0]
    model = copy.copy(scene.model)
    model.opt.gravity[:] = 0
    data = mujoco.MjData(model)
    posture = reachability_map(robot).postures_at(np.array([_HAND_POSITION]))[0]
    data.qpos[scene.joint_qpos[0]] = data.ctrl[scene.arm_ctrl[0]] = posture
    data.qpos[scene.finger_qpos[0]] = robot.finger_open
    data.ctrl[scene.finger_ctrl[0]] = robot.finger_closed
    data.qpos[address] = (*_HAND_POSITION, 1, 0, 0, 0)
    mujoco.mj_step(model, data, _SETTLING_STEPS)
    mujoco.mj_forward(model, data)
    tool = data.site_xpos[scene.tool_site[0]]
    pose = data.qpos[address].copy()
    offset = pose[:3] - tool
    if np.linalg.norm(offset) > cube.object_size:
        raise RuntimeError(f"the {robot.name} hand does not hold a cube of {cube.object_size} m")
    return Grasp(data.qpos[scene.finger_qpos[0]].copy(), offset, pose[3:])
