"""The least-squares GAN of equation 7.9."""

from __future__ import annotations

from torch import Tensor

from saver_envs.modelling.models.cgan import Cgan

#: Labels of fake and real samples for the discriminator, and the generator's target.
FAKE, REAL, WANTED = 0.0, 1.0, 1.0


class Lsgan(Cgan):
    """min_D (D(O|I) - 1)^2 / 2 + D(G(I*)|I*)^2 / 2, and min_G (D(G(I*)|I*) - 1)^2 / 2."""

    name = "lsgan"

    def _discriminator_loss(self, real: Tensor, fakes: list[Tensor]) -> Tensor:
        discriminator = self._discriminators[0]
        true, generated = discriminator(real) - REAL, discriminator(fakes[0]) - FAKE
        return 0.5 * (true.square().mean() + generated.square().mean())

    def _generator_loss(self, inputs: Tensor, outputs: Tensor, fakes: list[Tensor]) -> Tensor:
        return 0.5 * (self._discriminators[0](fakes[0]) - WANTED).square().mean()
