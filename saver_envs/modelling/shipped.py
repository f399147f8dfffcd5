"""Load the inverse models shipped with the package, one weight file per arm and task."""

from __future__ import annotations

from pathlib import Path

from saver_envs.modelling.arms import TASK_NAMES, Task
from saver_envs.modelling.models import InverseModel, load_model

WEIGHTS = Path(__file__).parent / "weights"
#: Selects the shipped adversarial model of inverse kinematics instead of the default network.
GAN = "gan"


def shipped_model(robot: str, task: Task = "ik", adversarial: bool = False) -> InverseModel:
    """Return the shipped inverse model of an arm.

    :param robot: the arm's name.
    :param task: ``ik``, inverse kinematics, or ``id``, inverse dynamics.
    :param adversarial: return the best adversarial model by validation, inverse kinematics only.
    :raises ValueError: for an arm or task without one.
    """
    kind = f"{task}-{GAN}" if adversarial else task
    path = WEIGHTS / f"{robot}-{kind}.safetensors"
    if not path.is_file():
        ending = f"-{kind}.safetensors"
        names = sorted(one.name.removesuffix(ending) for one in WEIGHTS.glob(f"*{ending}"))
        what = TASK_NAMES.get(task, f"task {task!r}")
        raise ValueError(
            f"robot={robot!r}: weights of {what} are shipped for {', '.join(names) or 'none'}"
        )
    return load_model(path, robot, task)


def model_for(robot: str, task: Task, model: InverseModel | str | Path | None) -> InverseModel:
    """Return the model to use for an arm and a task.

    :param robot: the arm's name.
    :param task: ``ik`` or ``id``.
    :param model: a fitted model, the path of a weight file, ``gan`` for the shipped adversarial
        model, or None for the shipped network.
    :raises ValueError: for a model of another arm or task.
    """
    if model is None:
        return shipped_model(robot, task)
    if model == GAN:
        return shipped_model(robot, task, adversarial=True)
    if not isinstance(model, InverseModel):
        return load_model(Path(model), robot, task)
    if model.robot != robot or model.task != task:
        raise ValueError(
            f"model={model.name!r} is of robot {model.robot!r}, task {model.task!r}: "
            f"{robot!r} needs its own model of {TASK_NAMES[task]}"
        )
    return model
