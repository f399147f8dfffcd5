"""The bidirectional GAN of equations 7.10 and 7.11."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor
from torch.nn import functional

from saver_envs.modelling.models.adversarial import AdversarialModel, squared_distance


class Bigan(AdversarialModel):
    """A generator I -> O, an encoder O -> I, one discriminator of I || O, and a loop.

    min_(G,E) max_D E[log D(O|I)] + E[log(1 - D(G(I*)|I*))] + E[log(1 - D(O*|E(O*)))], with
    I* ~ N(I, sigma^2) and O* ~ N(O, sigma^2); G and E also minimise ||I - E(G(I))||^2, weighted by
    ``loop_weight``.
    """

    name: ClassVar[str] = "bigan"
    has_encoder: ClassVar[bool] = True

    def _discriminator_loss(self, real: Tensor, fakes: list[Tensor]) -> Tensor:
        scores = self._discriminators[0](torch.cat([real, *fakes])).split(len(real))
        true, generated, encoded = (
            functional.softplus(one).mean() for one in (-scores[0], scores[1], scores[2])
        )
        return true + generated + encoded

    def _generator_loss(self, inputs: Tensor, outputs: Tensor, fakes: list[Tensor]) -> Tensor:
        generator, encoder = self._generators
        scores = self._discriminators[0](torch.cat(fakes)).split(len(inputs))
        fooled = -sum((functional.softplus(one).mean() for one in scores), torch.zeros(()))
        # Without noise the fakes contain G(I).
        generated = generator(inputs) if self._sigma else fakes[0][:, inputs.shape[1] :]
        return fooled + self._loop_weight * squared_distance(inputs, encoder(generated))
