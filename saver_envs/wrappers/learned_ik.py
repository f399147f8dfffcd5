"""Cartesian actions on an environment in joint control, through learned inverse kinematics."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from saver_envs.control import checked_action
from saver_envs.envs.spaces import episodes_of
from saver_envs.episodes import RATED_SPEED
from saver_envs.modelling.kinematics import REFINEMENT, LearnedInverseKinematics
from saver_envs.modelling.models import InverseModel
from saver_envs.simulation import ACTION_DURATION

#: Entries of ``info``: which arms' set-points are out of reach, and the distance to them that
#: remains (m).
UNREACHABLE, REACH_ERROR = "ik_unreachable", "ik_error"


class LearnedIKAction(gymnasium.ActionWrapper[Any, NDArray[np.float32], NDArray[np.float32]]):
    """Lets a Cartesian policy drive an environment that takes joint displacements.

    The action is that of the same id with ``control="cartesian"``: for each arm a displacement of
    its set-point, and the gripper's command where there is one. Set-points obey the same box, top
    speed and height. A learned model turns them into joints, and these into joint displacements,
    which the environment bounds by its joint speeds. Targets out of reach are replaced by the
    nearest reachable point; ``info["ik_unreachable"]`` tells for which arms.

    :param env: made with ``control="joints"``.
    :param model: a fitted model, the path of a weight file, ``gan`` for the shipped adversarial
        model, or None for the shipped network.
    :param refinement: Newton steps after the model's estimate.
    :raises ValueError: for an environment in Cartesian control, or a model of another robot.
    :raises TypeError: for an environment of another package.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        model: InverseModel | str | Path | None = None,
        refinement: int = REFINEMENT,
    ) -> None:
        super().__init__(env)
        episodes = episodes_of(env)
        if episodes.settings.control != "joints":
            raise ValueError("env: must be made with control='joints'")
        self._episodes = episodes
        self.kinematics = LearnedInverseKinematics(episodes.settings.robot, model, refinement)
        arms = episodes.task.n_arms
        self._gripper = episodes.action_size_per_arm - episodes.scene.joint_id.shape[1]
        self._cartesian = spaces.Box(-1.0, 1.0, (arms * (3 + self._gripper),), np.float32)
        self.action_space = self._cartesian
        self._error = np.zeros(arms)
        limits = np.asarray(episodes.settings.robot.joint_speed_limits)
        self._rated_step = limits / RATED_SPEED * ACTION_DURATION

    def action(self, action: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return the joint action for a Cartesian one, (arms * (3 or 4),) in [-1, 1].

        :raises ValueError: for a wrong shape or a value that is not finite.
        """
        episodes = self._episodes
        values = checked_action(action, self._cartesian.shape)
        blocks = values.reshape(1, episodes.task.n_arms, -1)
        arms = episodes.simulation.arm_state()
        target = episodes.moved_set_point(blocks[..., :3])
        present = arms.joint_position.reshape(-1, arms.joint_position.shape[-1])
        solution = self.kinematics.solve(target.reshape(-1, 3), present)
        self.kinematics.unreachable = ~solution.reachable
        self._error = solution.error
        commanded = episodes.simulation.ctrl.take(episodes.scene.arm_ctrl, 1)
        joints = solution.joints.reshape(commanded.shape)
        motion = (joints - commanded) / (self._rated_step * episodes.worlds.speed)
        # One factor for all joints of an arm: clipped one by one they would bend the tool's path.
        motion /= np.maximum(np.abs(motion).max(axis=-1, keepdims=True), 1.0)
        result = np.concatenate([motion, blocks[..., 3:]], axis=-1)
        return result.ravel().astype(np.float32)

    def step(self, action: NDArray[np.floating]) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Apply a Cartesian action; ``info`` says which arms' targets were out of reach."""
        observation, reward, terminated, truncated, info = super().step(action)
        info[UNREACHABLE] = self.kinematics.unreachable.copy()
        info[REACH_ERROR] = self._error.copy()
        return observation, reward, terminated, truncated, info
