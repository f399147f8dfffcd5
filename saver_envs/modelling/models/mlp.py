"""The supervised baseline: a perceptron trained on the squared error."""

from __future__ import annotations

from typing import ClassVar

from torch import Tensor, nn
from torch.nn import functional

from saver_envs.modelling.models.base import Training
from saver_envs.modelling.models.network_model import NetworkModel, adam, descend


class Mlp(NetworkModel):
    """A perceptron that minimises the mean squared error over standardised channels."""

    name: ClassVar[str] = "mlp"

    def _prepare(self, training: Training) -> nn.Module:
        self._network = self._predictor()
        self._optimisers = [adam(self._network.parameters(), training)]
        return self._network

    def _update(self, inputs: Tensor, outputs: Tensor) -> None:
        loss = functional.mse_loss(self._network(inputs), outputs)
        descend(self._optimisers[0], loss)
