"""Base class of the adversarial models: fake samples, alternating updates and optimisers."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import torch
from torch import Tensor, nn
from torch.nn import functional

from saver_envs.modelling.models.base import Training
from saver_envs.modelling.models.network_model import NetworkModel, adam, descend

#: Adam's decay rates: the first below the usual 0.9, as is common with adversarial losses.
_BETAS = (0.5, 0.999)


class AdversarialModel(NetworkModel):
    """A generator I -> O that predicts, perhaps an encoder O -> I, and discriminators of I || O.

    In every update the discriminators learn first, from generated samples without gradient, then
    the generators, with the discriminators fixed.
    """

    has_encoder: ClassVar[bool] = False
    n_discriminators: ClassVar[int] = 1

    def _prepare(self, training: Training) -> nn.Module:
        self._sigma, self._supervised = training.sigma, training.supervised_weight
        self._loop_weight = training.loop_weight
        inputs, outputs = self.network_input_size, self.output_size
        self._generators = [self._new_network(inputs, outputs)]
        if self.has_encoder:
            self._generators.append(self._new_network(outputs, inputs))
        self._discriminators = [
            self._new_network(inputs + outputs, 1) for _ in range(self.n_discriminators)
        ]
        self._optimisers = [
            adam([one for network in networks for one in network.parameters()], training, _BETAS)
            for networks in (self._generators, self._discriminators)
        ]
        return self._generators[0]

    def _fakes(self, inputs: Tensor, outputs: Tensor) -> list[Tensor]:
        """Return generated samples I || O, for the discriminators in turn."""
        near_inputs = self._near(inputs)
        fakes = [torch.cat([near_inputs, self._generators[0](near_inputs)], dim=1)]
        if self.has_encoder:
            near_outputs = self._near(outputs)
            fakes.append(torch.cat([self._generators[1](near_outputs), near_outputs], dim=1))
        return fakes

    @abstractmethod
    def _discriminator_loss(self, real: Tensor, fakes: list[Tensor]) -> Tensor:
        """Return the discriminators' loss.

        :param real: (n, inputs + outputs).
        :param fakes: what :meth:`_fakes` returned, detached.
        """

    @abstractmethod
    def _generator_loss(self, inputs: Tensor, outputs: Tensor, fakes: list[Tensor]) -> Tensor:
        """Return the generators' loss."""

    def _update(self, inputs: Tensor, outputs: Tensor) -> None:
        generator_adam, discriminator_adam = self._optimisers
        fakes = self._fakes(inputs, outputs)
        real = torch.cat([inputs, outputs], dim=1)
        detached = [fake.detach() for fake in fakes]
        descend(discriminator_adam, self._discriminator_loss(real, detached))
        self._after_discriminators()
        for network in self._discriminators:
            network.requires_grad_(False)
        loss = self._generator_loss(inputs, outputs, fakes)
        if self._supervised:
            predicted = self._generators[0](inputs)
            loss = loss + self._supervised * functional.mse_loss(predicted, outputs)
        descend(generator_adam, loss)
        for network in self._discriminators:
            network.requires_grad_(True)

    def _after_discriminators(self) -> None:
        """Constrain the discriminators' weights after their step."""

    def _near(self, values: Tensor) -> Tensor:
        """Return fake values, N(values, sigma^2) in every channel."""
        if not self._sigma:
            return values
        return values + self._sigma * torch.randn_like(values)


def squared_distance(first: Tensor, second: Tensor) -> Tensor:
    """Return ||first - second||^2 of rows, averaged over the batch."""
    return (first - second).square().sum(dim=1).mean()
