"""The parallel ensemble of chapter 4: one backbone, two stages of 13 independent branches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

from saver_envs.perception.backbones import BACKBONES, FEATURES, conv
from saver_envs.perception.fields import HEAT, N_CHANNELS
from saver_envs.perception.skeleton import LIMB_NAMES, N_LIMBS, limb_indices

#: Hidden layers of a branch: (kernel, channels) each. A 1 x 1 layer to 3 channels follows.
Layers = tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class Architecture:
    """What a network is made of.

    :param backbone: ``light`` or ``vgg19``.
    :param stage1: hidden layers of each branch of stage 1. The paper does not give them.
    :param stage2: of stage 2.
    :raises ValueError: for an unknown backbone.
    """

    backbone: str
    stage1: Layers
    stage2: Layers

    def __post_init__(self) -> None:
        if self.backbone not in BACKBONES:
            raise ValueError(f"backbone={self.backbone!r}: valid are {', '.join(BACKBONES)}")


LIGHT: Final = Architecture("light", ((1, 16), (3, 16), (3, 16)), ((1, 16),) + 3 * ((3, 16),))
VGG19: Final = Architecture("vgg19", 3 * ((3, 32),) + ((1, 64),), 5 * ((3, 32),) + ((1, 64),))
ARCHITECTURES: Final = {"light": LIGHT, "vgg19": VGG19}


class Branches(nn.Module):
    """Independent branches, one a limb, that read the same input.

    Their weights belong to each branch alone. They run as one: the first layers side by side in one
    convolution, the others as a convolution in groups, so that a few large operations do the work
    of many small ones; :meth:`one_by_one` runs them in sequence, with equal results.

    :param limbs: names.
    :param inputs: channels.
    :param layers: hidden layers of each branch.
    """

    def __init__(self, limbs: Sequence[str], inputs: int, layers: Layers) -> None:
        super().__init__()
        self.limbs = tuple(limbs)
        self.branches = nn.ModuleDict({limb: _branch(inputs, layers) for limb in limbs})

    def layers(self) -> list[list[nn.Conv2d]]:
        """Return the layers, and for each of them the branches' convolutions."""
        rows = [
            [layer for layer in branch.children() if isinstance(layer, nn.Conv2d)]
            for branch in self.branches.values()
        ]
        return [list(column) for column in zip(*rows, strict=True)]

    def forward(self, x: Tensor, channels: Tensor | None = None) -> Tensor:
        """Run all branches as one.

        :param x: (n, inputs, rows, columns).
        :param channels: which of the first layers' input channels ``x`` holds; the others count as
            zero. All where ``None``.
        :return: (n, 3 * limbs, rows, columns).
        """
        layers = self.layers()
        for depth, convs in enumerate(layers):
            weight, bias = fused(convs)
            if depth == 0 and channels is not None:
                weight = weight.index_select(1, channels)
            groups = 1 if depth == 0 else len(convs)
            padding = convs[0].kernel_size[0] // 2
            x = functional.conv2d(x, weight, bias, padding=padding, groups=groups)
            if depth < len(layers) - 1:
                x = functional.relu(x)
        return x

    def one_by_one(self, x: Tensor, channels: Tensor | None = None) -> Tensor:
        """Run the branches in sequence; see :meth:`forward`."""
        outputs = []
        for branch in self.branches.values():
            y = x
            for depth, layer in enumerate(branch.children()):
                if depth == 0 and channels is not None and isinstance(layer, nn.Conv2d):
                    weight = layer.weight.index_select(1, channels)
                    y = functional.conv2d(y, weight, layer.bias, padding=layer.kernel_size[0] // 2)
                else:
                    y = layer(y)
            outputs.append(y)
        return torch.cat(outputs, dim=1)


def _branch(inputs: int, layers: Layers) -> nn.Sequential:
    parts: list[nn.Module] = []
    for kernel, channels in layers:
        parts += [conv(inputs, channels, kernel), nn.ReLU()]
        inputs = channels
    return nn.Sequential(*parts, conv(inputs, N_CHANNELS, 1))


def fused(convs: Sequence[nn.Conv2d]) -> tuple[Tensor, Tensor]:
    """Return weight and bias of the branches' convolutions, one after the other."""
    biases = [layer.bias for layer in convs if layer.bias is not None]
    return torch.cat([layer.weight for layer in convs]), torch.cat(biases)


class PoseNetwork(nn.Module):
    """Backbone, stage 1, stage 2.

    :param architecture: of all parts.
    :param limbs: which limbs have branches, all 13 where ``None``.
    :raises ValueError: for an unknown limb.
    """

    def __init__(
        self, architecture: Architecture = LIGHT, limbs: Sequence[str] | None = None
    ) -> None:
        super().__init__()
        self.architecture = architecture
        self.limb_indices = limb_indices(limbs)
        self.limbs = tuple(LIMB_NAMES[limb] for limb in self.limb_indices)
        self.backbone = BACKBONES[architecture.backbone]()
        # Stage 2 reads F and all 39 channels, or of a part of the limbs those; see `forward`.
        whole = FEATURES + N_CHANNELS * N_LIMBS
        self.stage1 = Branches(self.limbs, FEATURES, architecture.stage1)
        self.stage2 = Branches(self.limbs, whole, architecture.stage2)
        chosen = [
            FEATURES + N_CHANNELS * limb + channel
            for limb in self.limb_indices
            for channel in range(N_CHANNELS)
        ]
        channels = torch.tensor([*range(FEATURES), *chosen])
        self.register_buffer("channels", channels, persistent=False)
        self.channels: Tensor

    def forward(self, pictures: Tensor, drop: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Return the fields of both stages.

        :param pictures: (n, 3, h, w), normalised red, green, blue; h and w multiples of 8.
        :param drop: (limbs,) of which limbs stage 2 reads zeros instead of stage 1's fields, as it
            does when it is run without them; for training.
        :return: two tensors (n, limbs, 3, h/8, w/8).
        """
        features = self.backbone(pictures)
        first = self.stage1(features)
        handed = first
        if drop is not None:
            kept = (~drop).to(first.dtype).repeat_interleave(N_CHANNELS)
            handed = first * kept[:, None, None]
        second = self.stage2(torch.cat([features, handed], dim=1), self._channels())
        return self._by_limb(first), self._by_limb(second)

    def one_by_one(self, pictures: Tensor) -> tuple[Tensor, Tensor]:
        """Do what :meth:`forward` does with the branches in sequence."""
        features = self.backbone(pictures)
        first = self.stage1.one_by_one(features)
        second = self.stage2.one_by_one(torch.cat([features, first], dim=1), self._channels())
        return self._by_limb(first), self._by_limb(second)

    def _channels(self) -> Tensor | None:
        return None if len(self.limbs) == N_LIMBS else self.channels

    def _by_limb(self, fields: Tensor) -> Tensor:
        return fields.unflatten(1, (len(self.limbs), N_CHANNELS))


def field_loss(
    stages: Sequence[Tensor], truth: Tensor, mask: Tensor, heat_weight: float = 1.0
) -> Tensor:
    """Return the squared error of all stages (eq. 4.1 to 4.3), summed over cells, mean over
    pictures.

    :param stages: each (n, limbs, 3, rows, columns).
    :param truth: the same shape.
    :param mask: (n, limbs, rows, columns), 1 where the error counts.
    :param heat_weight: of the joints' part of equation 4.2 against the limbs' part.
    """
    weights = truth.new_ones(N_CHANNELS)
    weights[HEAT] = heat_weight
    weighted = mask[:, :, None] * weights[:, None, None]
    total = truth.new_zeros(())
    for fields in stages:
        total = total + (weighted * (fields - truth) ** 2).sum()
    return total / len(truth)
