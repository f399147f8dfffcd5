"""The dual GAN of equations 7.12 and 7.13."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from saver_envs.modelling.models.adversarial import AdversarialModel, squared_distance

#: Bound of the discriminators' weights, as in the dual GAN that the paper cites (Yi et al., 2017):
#: a Wasserstein distance needs a Lipschitz bound.
WEIGHT_BOUND = 0.1


class Dualgan(AdversarialModel):
    """Generators A: I -> O and B: O -> I, a discriminator for each, and a loop each way.

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
