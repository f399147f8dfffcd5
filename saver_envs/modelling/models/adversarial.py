"""The adversarial models (equations 7.8 to 7.13), and their alternating updates."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import torch
from torch import Tensor, nn
from torch.nn import functional

from saver_envs.modelling.models.base import Training
from saver_envs.modelling.models.network_model import NetworkModel, adam, descend

#: Labels of fake and real samples for the least-squares discriminator, and the generator's target.
FAKE, REAL, WANTED = 0.0, 1.0, 1.0
#: Bound of the discriminators' weights, as in the dual GAN that the paper cites (Yi et al., 2017):
#: a Wasserstein distance needs a Lipschitz bound.
WEIGHT_BOUND = 0.1
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


class Cgan(AdversarialModel):
    """The conditional GAN of equation 7.8.

    min_G max_D E[log D(O|I)] + E[log(1 - D(G(I*)|I*))], with I* ~ N(I, sigma^2).

    The discriminator reads I || O and returns a logit s, D = sigmoid(s): log D is -softplus(-s),
    and log(1 - D) is -softplus(s). The generator minimises the same term that the discriminator
    maximises.
    """

    name: ClassVar[str] = "cgan"

    def _discriminator_loss(self, real: Tensor, fakes: list[Tensor]) -> Tensor:
        true, *made = self._discriminators[0](torch.cat([real, *fakes])).split(len(real))
        fooled = (functional.softplus(one).mean() for one in made)
        return sum(fooled, functional.softplus(-true).mean())

    def _generator_loss(self, inputs: Tensor, outputs: Tensor, fakes: list[Tensor]) -> Tensor:
        scores = self._discriminators[0](torch.cat(fakes)).split(len(inputs))
        return -sum((functional.softplus(one).mean() for one in scores), torch.zeros(()))


class Lsgan(Cgan):
    """The least-squares GAN of equation 7.9.

    min_D (D(O|I) - 1)^2 / 2 + D(G(I*)|I*)^2 / 2, and min_G (D(G(I*)|I*) - 1)^2 / 2.
    """

    name = "lsgan"

    def _discriminator_loss(self, real: Tensor, fakes: list[Tensor]) -> Tensor:
        discriminator = self._discriminators[0]
        true, generated = discriminator(real) - REAL, discriminator(fakes[0]) - FAKE
        return 0.5 * (true.square().mean() + generated.square().mean())

    def _generator_loss(self, inputs: Tensor, outputs: Tensor, fakes: list[Tensor]) -> Tensor:
        return 0.5 * (self._discriminators[0](fakes[0]) - WANTED).square().mean()


class Bigan(Cgan):
    """The bidirectional GAN of equations 7.10 and 7.11.

    A generator I -> O, an encoder O -> I, one discriminator of I || O, and a loop:
    min_(G,E) max_D E[log D(O|I)] + E[log(1 - D(G(I*)|I*))] + E[log(1 - D(O*|E(O*)))], with
    I* ~ N(I, sigma^2) and O* ~ N(O, sigma^2); G and E also minimise ||I - E(G(I))||^2, weighted by
    ``loop_weight``.
    """

    name: ClassVar[str] = "bigan"
    has_encoder: ClassVar[bool] = True

    def _generator_loss(self, inputs: Tensor, outputs: Tensor, fakes: list[Tensor]) -> Tensor:
        generator, encoder = self._generators
        fooled = super()._generator_loss(inputs, outputs, fakes)
        # Without noise the fakes contain G(I).
        generated = generator(inputs) if self._sigma else fakes[0][:, inputs.shape[1] :]
        return fooled + self._loop_weight * squared_distance(inputs, encoder(generated))


class Dualgan(AdversarialModel):
    """The dual GAN of equations 7.12 and 7.13.

    Generators A: I -> O and B: O -> I, a discriminator for each, and a loop each way.

    The discriminators minimise l_A = D_A([I* || A(I*)]) - D_A([I || O]) and
    l_B = D_B([B(O*) || O*]) - D_B([I || O]); the generators minimise -D_A - D_B of their fakes, and
    ||I - B(A(I))||^2 + ||O - A(B(O))||^2 weighted by ``loop_weight``.
    """

    name: ClassVar[str] = "dualgan"
    has_encoder: ClassVar[bool] = True
    n_discriminators: ClassVar[int] = 2

    def _discriminator_loss(self, real: Tensor, fakes: list[Tensor]) -> Tensor:
        loss = torch.zeros(())
        for discriminator, fake in zip(self._discriminators, fakes, strict=True):
            loss = loss + discriminator(fake).mean() - discriminator(real).mean()
        return loss

    def _after_discriminators(self) -> None:
        with torch.no_grad():
            for discriminator in self._discriminators:
                for parameter in discriminator.parameters():
                    parameter.clamp_(-WEIGHT_BOUND, WEIGHT_BOUND)

    def _generator_loss(self, inputs: Tensor, outputs: Tensor, fakes: list[Tensor]) -> Tensor:
        forward, backward = self._generators
        loss = torch.zeros(())
        for discriminator, fake in zip(self._discriminators, fakes, strict=True):
            loss = loss - discriminator(fake).mean()
        size = inputs.shape[1]
        if self._sigma:
            there, back = forward(inputs), backward(outputs)
        else:
            there, back = fakes[0][:, size:], fakes[1][:, :size]  # already computed
        loops = squared_distance(inputs, backward(there)) + squared_distance(outputs, forward(back))
        return loss + self._loop_weight * loops
