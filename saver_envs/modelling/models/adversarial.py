"""What the adversarial models share: fake inputs, the two turns of an update, their optimisers."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable

import torch
from torch import Tensor, nn
from torch.nn import functional

from saver_envs.modelling.models.base import Training
from saver_envs.modelling.models.network_model import NetworkModel, adam

#: Adam's decay rates: the first below the usual 0.9, as is the custom with adversarial losses.
_BETAS = (0.5, 0.999)


class AdversarialModel(NetworkModel):
    """A generator that predicts, other networks that map back, and discriminators that judge.

    In every update the discriminators learn first, from generated samples through which no
    gradient flows, then the generators, from discriminators that stay as they are.
    """

    def _prepare(self, training: Training) -> nn.Module:
        self._sigma, self._supervised = training.sigma, training.supervised_weight
        self._loop_weight = training.loop_weight
        generators, discriminators = self._build()
        self._generators, self._discriminators = generators, discriminators
        self._generator_adam = _adam(generators, training)
        self._discriminator_adam = _adam(discriminators, training)
        return generators[0]

    def _optimisers(self) -> list[torch.optim.Optimizer]:
        return [self._generator_adam, self._discriminator_adam]

    @abstractmethod
    def _build(self) -> tuple[list[nn.Module], list[nn.Module]]:
        """Return generators, the predicting one first, and discriminators."""

    @abstractmethod
    def _fakes(self, inputs: Tensor, outputs: Tensor) -> list[Tensor]:
        """Return generated samples I || O, for the discriminators in turn."""

    @abstractmethod
    def _discriminator_loss(self, real: Tensor, fakes: list[Tensor]) -> Tensor:
        """Return what the discriminators minimise.

        :param real: (n, inputs + outputs).
        :param fakes: what :meth:`_fakes` returned, detached.
        """

    @abstractmethod
    def _generator_loss(self, inputs: Tensor, outputs: Tensor, fakes: list[Tensor]) -> Tensor:
        """Return what the generators minimise."""

    def _update(self, inputs: Tensor, outputs: Tensor) -> None:
        fakes = self._fakes(inputs, outputs)
        real = torch.cat([inputs, outputs], dim=1)
        loss = self._discriminator_loss(real, [fake.detach() for fake in fakes])
        self._discriminator_adam.zero_grad()
        loss.backward()
        self._discriminator_adam.step()
        self._after_discriminators()
        for network in self._discriminators:
            network.requires_grad_(False)
        loss = self._generator_loss(inputs, outputs, fakes)
        if self._supervised:
            predicted = self._generators[0](inputs)
            loss = loss + self._supervised * functional.mse_loss(predicted, outputs)
        self._generator_adam.zero_grad()
        loss.backward()
        self._generator_adam.step()
        for network in self._discriminators:
            network.requires_grad_(True)

    def _after_discriminators(self) -> None:
        """Do what must follow a discriminators' step."""

    def _near(self, values: Tensor) -> Tensor:
        """Return fake values, N(values, sigma^2) in every channel."""
        if not self._sigma:
            return values
        return values + self._sigma * torch.randn_like(values)

    def _judge(self) -> nn.Module:
        """Return a fresh discriminator of I || O, one logit or score."""
        return self._new_network(self.network_input_size + self.output_size, 1)


def squared_distance(first: Tensor, second: Tensor) -> Tensor:
    """Return ||first - second||^2 of rows, averaged over the batch."""
    return (first - second).square().sum(dim=1).mean()


def _adam(networks: Iterable[nn.Module], training: Training) -> torch.optim.Adam:
    return adam([one for network in networks for one in network.parameters()], training, _BETAS)
