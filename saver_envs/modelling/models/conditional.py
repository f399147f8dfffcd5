"""Inverse kinematics that also knows the present joints.

A position does not determine four or eight joints: a regressor of the position alone averages over
what it has seen. Given where the joints are now, the answer is the one nearby.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from saver_envs.modelling.arms import Task
from saver_envs.modelling.models.base import FloatArray
from saver_envs.modelling.models.mlp import Mlp
from saver_envs.modelling.networks import Architecture

#: The present joints of a training sample are those of so many samples before it at most.
LONGEST_LAG = 16
#: And they are off by this (rad, m): a controlled arm is never exactly where a recording was.
_NOISE = 0.02


class Conditional(Mlp):
    """A perceptron of the target and the present joints, trained on pairs along trajectories.

    :raises ValueError: for inverse dynamics, which has no use for it.
    """

    name: ClassVar[str] = "conditional"
    needs_present: ClassVar[bool] = True

    def __init__(self, robot: str, task: Task, architecture: Architecture | None = None) -> None:
        if task != "ik":
            raise ValueError(f"task={task!r}: 'conditional' is for inverse kinematics alone")
        super().__init__(robot, task, architecture)

    @property
    def network_input_size(self) -> int:
        """A target and a joint vector."""
        return self.input_size + self.output_size

    def _network_inputs(
        self, inputs: FloatArray, outputs: FloatArray, generator: np.random.Generator
    ) -> FloatArray:
        rows = np.arange(len(inputs))
        before = np.maximum(rows - generator.integers(0, LONGEST_LAG + 1, len(rows)), 0)
        present = outputs[before] + _NOISE * generator.standard_normal(outputs.shape)
        return np.concatenate([inputs, present], axis=1)

    def predict(self, inputs: FloatArray, present: FloatArray | None = None) -> FloatArray:
        """Return joints (n, dof) near the present ones."""
        inputs = self._checked(inputs, self.input_size, "inputs")
        if present is None:
            raise ValueError("present=None: 'conditional' needs the present joints")
        present = self._checked(present, self.output_size, "present")
        return self._forward(np.concatenate([inputs, present], axis=1))
