"""Analytic models: iterated inverse kinematics, and Newton-Euler with the inertia of Appendix A."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from torch import Tensor

from saver_envs.modelling.arms import Task
from saver_envs.modelling.chain import FloatArray
from saver_envs.modelling.models.base import History, InverseModel, Progress, Training
from saver_envs.modelling.newton_euler import inverse_dynamics
from saver_envs.modelling.solvers import reach


class Analytic(InverseModel):
    """Inverse of the forward model, or dynamics with the data sheet's inertia.

    Inverse kinematics iterates damped least squares from the arm's home posture, or from the
    present joints if given; inverse dynamics is recursive Newton-Euler with the inertia of
    Appendix A.

    :raises ValueError: for the dynamics of an arm that Appendix A does not list.
    """

    name: ClassVar[str] = "analytic"

    def __init__(self, robot: str, task: Task) -> None:
        super().__init__(robot, task)
        links = self.arm.appendix_links
        if task == "id" and links is None:
            raise ValueError(f"robot={robot!r}: Appendix A has no inertia for it")
        self._links = links() if links is not None and task == "id" else None

    def _fit(
        self, inputs: FloatArray, outputs: FloatArray, training: Training, progress: Progress
    ) -> History:
        """Measure the error; there is nothing to learn."""
        few = slice(0, len(inputs), max(1, len(inputs) // 2000))
        history = History()
        history.add(self.predict(inputs[few]) - outputs[few])
        return history

    def _predict(self, inputs: FloatArray, present: FloatArray | None) -> FloatArray:
        if self._links is not None:
            position, velocity, acceleration = np.split(inputs, 3, axis=1)
            return inverse_dynamics(self.arm.chain, self._links, position, velocity, acceleration)
        return reach(self.arm, inputs, present, self.arm.chain).joints

    def _restore(self, tensors: dict[str, Tensor], settings: dict[str, Any]) -> None:
        """Do nothing: there is nothing to learn."""
