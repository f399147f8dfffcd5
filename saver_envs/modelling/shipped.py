"""Inverse models that come along, a weight file an arm and task."""

from __future__ import annotations

from pathlib import Path

from saver_envs.modelling.arms import TASK_NAMES, Task
from saver_envs.modelling.models import InverseModel, load_model

WEIGHTS = Path(__file__).parent / "weights"


def shipped_model(robot: str, task: Task = "ik") -> InverseModel:
    """Return the inverse model that comes along for an arm.

    :param robot: the arm's name.
    :param task: ``ik``, inverse kinematics, or ``id``, inverse dynamics.
    :raises ValueError: for an arm or task without one.
    """
    path = WEIGHTS / f"{robot}-{task}.safetensors"
    if not path.is_file():
        ending = f"-{task}.safetensors"
        names = sorted(one.name.removesuffix(ending) for one in WEIGHTS.glob(f"*{ending}"))
        kind = TASK_NAMES.get(task, f"task {task!r}")
        raise ValueError(
            f"robot={robot!r}: weights of {kind} come along for {', '.join(names) or 'none'}"
        )
    return load_model(path, robot, task)
