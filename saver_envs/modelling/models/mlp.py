"""The supervised baseline: squared error, nothing else."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor, nn
from torch.nn import functional

from saver_envs.modelling.models.base import Training
from saver_envs.modelling.models.network_model import NetworkModel, adam


class Mlp(NetworkModel):
    """A perceptron that minimises the mean squared error over standardised channels."""

    name: ClassVar[str] = "mlp"

    def _prepare(self, training: Training) -> nn.Module:
        self._network = self._new_network(self.network_input_size, self.output_size)
        self._adam = adam(self._network.parameters(), training)
        return self._network

    def _optimisers(self) -> list[torch.optim.Optimizer]:
        return [self._adam]

    def _update(self, inputs: Tensor, outputs: Tensor) -> None:
        loss = functional.mse_loss(self._network(inputs), outputs)
        self._adam.zero_grad()
        loss.backward()
        self._adam.step()
