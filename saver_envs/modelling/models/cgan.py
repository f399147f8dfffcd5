"""The conditional GAN of equation 7.8."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor
from torch.nn import functional

from saver_envs.modelling.models.adversarial import AdversarialModel


class Cgan(AdversarialModel):
    """min_G max_D E[log D(O|I)] + E[log(1 - D(G(I*)|I*))], with I* ~ N(I, sigma^2).

    The discriminator reads I || O and returns a logit s, D = sigmoid(s): log D is -softplus(-s),
    and log(1 - D) is -softplus(s). The generator minimises the same term that the discriminator
    maximises.
    """

    name: ClassVar[str] = "cgan"

    def _discriminator_loss(self, real: Tensor, fakes: list[Tensor]) -> Tensor:
        true, generated = self._discriminators[0](torch.cat([real, *fakes])).split(len(real))
        return functional.softplus(-true).mean() + functional.softplus(generated).mean()

    def _generator_loss(self, inputs: Tensor, outputs: Tensor, fakes: list[Tensor]) -> Tensor:
        return -functional.softplus(self._discriminators[0](fakes[0])).mean()
