"""What experts that straighten limbs have in common: mirrored frames, ways over a person."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from saver_envs.experts.geometry import FloatArray, length
from saver_envs.tasks.contract import PENDING, Task
from saver_envs.tasks.hand_force import FORCE

#: Sign of the outward direction along y, arm by arm.
OUTWARDS: Final = np.array([-1.0, 1.0])
#: Share of the way left that an action covers.
GAIN: Final = 0.3


def mirrored(points: FloatArray) -> FloatArray:
    """Return points or displacements (n, arms, 3) with y outwards, or back."""
    result = np.array(points)
    result[..., 1] *= OUTWARDS
    return result


def seen_points(
    task: Task, observation: Mapping[str, FloatArray], parts: Mapping[str, str]
) -> dict[str, FloatArray]:
    """Return the tools, the targets and further points (n, arms, 3) that arms see, y outwards.

    :param task: whose observation it is.
    :param observation: batched.
    :param parts: name of a point -> name of its part, but for ``position``.
    """
    layout, seen = task.observation_layout, observation["observation"]
    tool = layout.get(seen, "gripper position")
    if task.observe_pending_motion:
        tool = tool + layout.get(seen, PENDING.name)
    points = {name: layout.get(seen, f"{part} position") for name, part in parts.items()}
    points["target"] = task.goal_layout.get(observation["desired_goal"], "object position")
    return {name: mirrored(values) for name, values in (points | {"tool": tool}).items()}


def hand_force(task: Task, observation: Mapping[str, FloatArray]) -> FloatArray:
    """Return what hands press with (n, arms), N.

    :param task: whose observation it is.
    :param observation: batched.
    """
    layout = task.observation_layout
    pressed = layout.get(observation["observation"], FORCE.name)
    return length(pressed) / FORCE.scale


def way_over(
    tool: FloatArray, way: FloatArray, height: FloatArray | float, down: float, step: float
) -> FloatArray:
    """Return displacements (n, arms, 3) to a point: up, across, and down at the point, metres.

    :param tool: (n, arms, 3).
    :param way: (n, arms, 3) from there to the point.
    :param height: at which hands cross, above what is in the way.
    :param down: longest displacement downwards.
    :param step: longest displacement of an action.
    """
    aside = length(way[..., :2])
    lower = np.clip(GAIN * way[..., 2], -down, step)
    up = GAIN * (height - tool[..., 2])
    rise = np.select([aside < 0.02, aside < 0.05], [lower, np.zeros_like(lower)], up)
    crosses = (tool[..., 2] > height - 0.06) | (aside < 0.05)
    level = np.where(crosses[..., None], GAIN * way[..., :2], 0.0)
    return np.concatenate([level, rise[..., None]], axis=-1)
