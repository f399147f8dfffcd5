"""Builds the expert of an id, with the ``predict`` of a trained policy."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from saver_envs.episodes import Settings
from saver_envs.experts.blocks import ArmView, Viewer
from saver_envs.experts.geometry import FloatArray
from saver_envs.registration import task_and_settings
from saver_envs.tasks.contract import Task


class Planner(Protocol):
    """Chooses among plans to share the table."""

    @property
    def plans(self) -> int:
        """Number of plans."""

    def actions(self, view: ArmView) -> FloatArray:
        """Return the actions (n, arms, size) under the best plans."""

    def follow(self, view: ArmView, chosen: NDArray[np.intp]) -> FloatArray:
        """Return the actions (n, arms, size) under plans ``chosen`` (n,)."""


class Expert:
    """A scripted policy.

    :param task: whose observations it reads.
    :param act: from what the arms see to their actions (n, arms, size).
    :param planner: whose plans it follows, if any.
    :param read: from a batched observation to what ``act`` takes; by default a :class:`Viewer`, for
        arms with an object each.
    :param free_arm: the only arm that moves; all do by default.
    """

    def __init__(
        self,
        task: Task,
        act: Callable[[Any], FloatArray],
        planner: Planner | None = None,
        read: Callable[[dict[str, FloatArray]], Any] | None = None,
        free_arm: int | None = None,
    ) -> None:
        self.task = task
        self.planner = planner
        self.n_arms = task.n_arms
        self._act = act
        self._read = read or Viewer(task)
        arms = range(task.n_arms)
        self._at_rest = [arm for arm in arms if free_arm not in (None, arm)]

    def predict(
        self, observation: dict[str, FloatArray], deterministic: bool = True
    ) -> tuple[NDArray[np.float32], None]:
        """Return actions for observations, as Stable-Baselines3's policies do.

        :param observation: of one environment, or of n with a leading dimension; an expert that
            looks ahead keeps its plans from call to call, so give it the same n in the same order.
        :param deterministic: not used; experts always are.
        :return: actions (size,) or (n, size), and no state.
        """
        single = np.ndim(observation["observation"]) == 1
        batch = {name: np.atleast_2d(values) for name, values in observation.items()}
        actions = self._act(self._read(batch))
        actions[:, self._at_rest] = 0.0
        flat = np.clip(actions.reshape(len(actions), -1), -1.0, 1.0).astype(np.float32)
        return (flat[0] if single else flat), None


def make_expert(
    env_id: str, *, coordinated: bool = True, free_arm: int | None = None, **options: Any
) -> Expert:
    """Build the expert of an id.

    :param env_id: a registered id.
    :param coordinated: arms give way to one another; else each acts as if it were alone.
    :param free_arm: the only arm that moves, and serves all objects in turn; all move by default.
    :param options: the environment's keyword arguments.
    :return: the expert.
    :raises ValueError: for an unknown id, a task without an expert, or options that no expert is
        written for.
    :raises TypeError: for an unknown option.
    """
    task, settings = task_and_settings(env_id, options)
    return expert_of(task, settings, coordinated=coordinated, free_arm=free_arm)


def expert_of(
    task: Task, settings: Settings, *, coordinated: bool = True, free_arm: int | None = None
) -> Expert:
    """Build the expert of a task; see :func:`make_expert`.

    The task names a function ``(task, settings, coordinated, free_arm) -> Expert``.

    :param task: of the episodes.
    :param settings: of the episodes.
    :param coordinated: as for :func:`make_expert`.
    :param free_arm: as for :func:`make_expert`.
    :return: the expert.
    :raises ValueError: for a task without an expert, or settings that no expert is written for.
    """
    if task.expert is None:
        raise ValueError(f"the task {task.name!r} has no expert")
    if settings.control != "cartesian":
        raise ValueError(f"control={settings.control!r}: experts command Cartesian displacements")
    if task.bases == "ring" and task.n_arms > 1 and coordinated:
        raise ValueError(f"layout={task.bases!r}: experts coordinate arms in a row")
    if free_arm is not None and not 0 <= free_arm < task.n_arms:
        raise ValueError(f"free_arm={free_arm!r}: must be 0 to {task.n_arms - 1}")
    module, _, function = task.expert.partition(":")
    build = getattr(importlib.import_module(module), function)
    return build(task, settings, coordinated, free_arm)
