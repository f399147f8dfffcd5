"""Writes what differs between episodes into the model of each simulation.

A batch of simulations shares its model but for the fields that were expanded. Those of the arms and
the cameras are written here; a task writes those of its own bodies.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.randomization.presets import Values
from saver_envs.scenes import Scene
from saver_envs.simulation import Simulation


def write_arm_fields(simulation: Simulation, rows: NDArray[np.intp], values: Values) -> None:
    """Give the arms of some simulations their own servos, tool points and joint friction.

    :param simulation: of all episodes.
    :param rows: (k,) which of them.
    :param values: parameter -> (k, size); others than those of the arms are ignored.
    """
    scene, base = simulation.scene, simulation.scene.model
    every, servos = rows[:, None], scene.arm_ctrl.ravel()
    if "servo_stiffness" in values:
        gain = base.actuator_gainprm[servos, 0] * values["servo_stiffness"]
        simulation.per_simulation("actuator_gainprm")[every, servos, 0] = gain
        simulation.per_simulation("actuator_biasprm")[every, servos, 1] = -gain
    if "servo_damping" in values:
        damping = base.actuator_biasprm[servos, 2] * values["servo_damping"]
        simulation.per_simulation("actuator_biasprm")[every, servos, 2] = damping
    if "tool_offset" in values:
        offset = values["tool_offset"].reshape(len(rows), scene.n_arms, 3)
        sites = scene.tool_site
        simulation.per_simulation("site_pos")[every, sites] = base.site_pos[sites] + offset
    if "joint_friction" in values:
        limits = np.asarray(scene.robot.joint_torque_limits)
        simulation.give_joint_friction(rows, values["joint_friction"][:, :, None] * limits)


def move_cameras(model: mujoco.MjModel, scene: Scene, values: Values, row: int) -> None:
    """Move the cameras of a drawing model to where they are in an episode.

    :param model: to draw; changed.
    :param scene: of the episodes.
    :param values: parameter -> (n, size).
    :param row: which episode.
    """
    nominal = scene.drawing_model()
    if "camera_position" in values:
        shift = values["camera_position"][row]
        model.cam_pos[:] = nominal.cam_pos + shift
    if "camera_rotation" in values:
        turn = values["camera_rotation"][row]
        for camera in range(model.ncam):
            quaternion = nominal.cam_quat[camera].copy()
            mujoco.mju_quatIntegrate(quaternion, turn, 1.0)
            model.cam_quat[camera] = quaternion
