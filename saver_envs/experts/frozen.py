"""The ablation: one arm serves every cube in turn while the others stay where they are."""

from __future__ import annotations

import numpy as np

from saver_envs.experts.blocks import ArmView
from saver_envs.experts.expert import Expert
from saver_envs.experts.geometry import FloatArray
from saver_envs.experts.skill import Skill
from saver_envs.scenes import base_poses
from saver_envs.tasks.contract import Task


def serves_all(task: Task, skill: Skill, free: int) -> Expert:
    """Build an expert whose free arm serves its own cube and its neighbours' in turn.

    :param task: with arms in a row.
    :param skill: what an arm does by itself.
    :param free: index of the arm that moves; the actions of the others are zero.
    """
    base, arms = base_poses(task.n_arms, "row")[0], task.n_arms
    order = sorted(range(arms), key=lambda arm: ((arm == free) == skill.own_last, arm))

    def act(view: ArmView) -> FloatArray:
        left = ~skill.finished(view)[:, order]
        arm = np.asarray(order)[np.where(left.any(axis=1), left.argmax(axis=1), arms - 1)]
        rows, own = np.arange(len(arm)), slice(free, free + 1)
        shift = (base - base[free])[arm][:, None]
        served = ArmView(
            tool=view.tool[:, own],
            tool_velocity=view.tool_velocity[:, own],
            top_speed=view.top_speed[:, own],
            fingers=view.fingers[:, own],
            finger_velocity=view.finger_velocity[:, own],
            object=view.object[rows, arm][:, None] + shift,
            object_quaternion=view.object_quaternion[rows, arm][:, None],
            object_velocity=view.object_velocity[rows, arm][:, None],
            target=view.target[rows, arm][:, None] + shift,
            object_size=view.object_size[rows, arm][:, None],
            table=view.table[:, own],
            begins=view.begins,
        )
        action = skill.actions(served)
        result = np.zeros((len(arm), arms, action.shape[-1]))
        result[:, own] = action
        return result

    return Expert(task, act)
