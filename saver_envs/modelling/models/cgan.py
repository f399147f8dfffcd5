"""The conditional GAN of equation 7.8."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor, nn
from torch.nn import functional

from saver_envs.modelling.models.adversarial import AdversarialModel


class Cgan(AdversarialModel):
    """min_G max_D E[log D(O|I)] + E[log(1 - D(G(I*)|I*))], with I* ~ N(I, sigma^2).

    The discriminator reads I || O and gives a logit s, D = sigmoid(s): log D is -softplus(-s), and
    log(1 - D) is -softplus(s). The generator minimises the very term that the discriminator
    maximises.
    """

    name: ClassVar[str] = "cgan"

    def _build(self) -> tuple[list[nn.Module], list[nn.Module]]:
        return [self._new_network(self.network_input_size, self.output_size)], [self._judge()]

    def _fakes(self, inputs: Tensor, outputs: Tensor) -> list[Tensor]:
        near = self._near(inputs)
        return [torch.cat([near, self._generators[0](near)], dim=1)]

    def _discriminator_loss(self, real: Tensor, fakes: list[Tensor]) -> Tensor:
        scores = self._discriminators[0](torch.cat([real, *fakes]))
        return _cross_entropy(scores[: len(real)], scores[len(real) :])

    def _generator_loss(self, inputs: Tensor, outputs: Tensor, fakes: list[Tensor]) -> Tensor:
        return -functional.softplus(self._discriminators[0](fakes[0])).mean()


def _cross_entropy(real: Tensor, fake: Tensor) -> Tensor:
    """-E[log D(real)] - E[log(1 - D(fake))] of logits."""
    return functional.softplus(-real).mean() + functional.softplus(fake).mean()
