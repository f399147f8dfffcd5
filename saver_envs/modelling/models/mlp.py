"""The supervised models: a perceptron trained on the squared error, with or without the joints."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from torch import Tensor
from torch.nn import functional

from saver_envs.modelling.arms import Task
from saver_envs.modelling.chain import FloatArray
from saver_envs.modelling.models.network_model import NetworkModel, descend

#: The present joints of a training sample are those of at most this many samples before it.
LONGEST_LAG = 16
#: Standard deviation of the noise added to them (rad, m): a controlled arm deviates from any
#: recording.
_NOISE = 0.02


class Mlp(NetworkModel):
    """A perceptron that minimises the mean squared error over standardised channels."""

    name: ClassVar[str] = "mlp"

    def _update(self, inputs: Tensor, outputs: Tensor) -> None:
        loss = functional.mse_loss(self._network(inputs), outputs)
        descend(self._optimisers[0], loss)


class Conditional(Mlp):
    """A perceptron of the target and the present joints, trained on pairs along trajectories.

    A position does not determine four or eight joints: a regressor of the position alone averages
    over the solutions in its data. Given the present joints, the solution is the nearest one.

    :raises ValueError: for inverse dynamics.
    """

    name: ClassVar[str] = "conditional"
    needs_present: ClassVar[bool] = True
    tasks: ClassVar[tuple[Task, ...]] = ("ik",)

    @property
    def network_input_size(self) -> int:
        """Size of a target and a joint vector."""
        return self.input_size + self.output_size

    def _network_inputs(
        self, inputs: FloatArray, outputs: FloatArray, generator: np.random.Generator
    ) -> FloatArray:
        rows = np.arange(len(inputs))
        before = np.maximum(rows - generator.integers(0, LONGEST_LAG + 1, len(rows)), 0)
        present = outputs[before] + _NOISE * generator.standard_normal(outputs.shape)
        return np.concatenate([inputs, present], axis=1)

    def _predict(self, inputs: FloatArray, present: FloatArray | None) -> FloatArray:
        if present is None:
            raise ValueError("present=None: 'conditional' needs the present joints")
        present = self._checked(present, self.output_size, "present")
        return self._forward(np.concatenate([inputs, present], axis=1))
