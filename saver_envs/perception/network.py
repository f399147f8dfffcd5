"""The parallel ensemble of chapter 4: one backbone, two stages of 13 independent branches."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

from saver_envs.perception.backbones import BACKBONES, FEATURES, conv
from saver_envs.perception.fields import HEAT, N_CHANNELS
from saver_envs.perception.skeleton import LIMB_NAMES, N_LIMBS, limb_indices

MAX_LAYERS: Final = 32
#: Hidden layers of a branch: (kernel, channels) each. A 1 x 1 layer to 3 channels follows.
Layers = tuple[tuple[int, int], ...]
#: Runs the branches of a stage on an input and the channels that it holds.
RunBranches = Callable[[Tensor, Tensor | None], Tensor]


@dataclass(frozen=True)
class PoseArchitecture:
    """The layers of a pose network.

    :param backbone: ``light`` or ``vgg19``.
    :param stage1: hidden layers of each branch of stage 1. The paper does not give them.
    :param stage2: hidden layers of each branch of stage 2.
    :raises ValueError: for an unknown backbone, or layers that no pose network needs: a file may
        ask for more than fits into memory.
    """

    backbone: str
    stage1: Layers
    stage2: Layers

    def __post_init__(self) -> None:
        if self.backbone not in BACKBONES:
            raise ValueError(f"backbone={self.backbone!r}: valid are {', '.join(BACKBONES)}")
        for name, layers in (("stage1", self.stage1), ("stage2", self.stage2)):
            small = all(1 <= kernel <= 31 and 1 <= width <= 1024 for kernel, width in layers)
            if not small or len(layers) > MAX_LAYERS:
                raise ValueError(
                    f"{name} must have at most {MAX_LAYERS} layers, with kernels from 1 to 31 and "
                    "1 to 1,024 channels"
                )


LIGHT: Final = PoseArchitecture("light", ((1, 16), (3, 16), (3, 16)), ((1, 16),) + 3 * ((3, 16),))
VGG19: Final = PoseArchitecture("vgg19", 3 * ((3, 32),) + ((1, 64),), 5 * ((3, 32),) + ((1, 64),))
ARCHITECTURES: Final = {"light": LIGHT, "vgg19": VGG19}


class Branches(nn.Module):
    """Independent branches, one for each limb, that read the same input.

    No two branches share weights. :meth:`forward` runs them together: the first layers side by side
    in one convolution, the others as grouped convolutions, so that a few large operations replace
    many small ones. :meth:`one_by_one` runs them in sequence, with equal results.

    :param limbs: names.
    :param inputs: channels of the input.
    :param layers: hidden layers of each branch.
    """

    def __init__(self, limbs: Sequence[str], inputs: int, layers: Layers) -> None:
        super().__init__()
        self.limbs = tuple(limbs)
        self.branches = nn.ModuleDict({limb: _branch(inputs, layers) for limb in limbs})

    def layers(self) -> list[list[nn.Conv2d]]:
        """Return, for each layer, the convolutions of all branches."""
        rows = [
            [layer for layer in branch.children() if isinstance(layer, nn.Conv2d)]
            for branch in self.branches.values()
        ]
        return [list(column) for column in zip(*rows, strict=True)]

    def forward(self, x: Tensor, channels: Tensor | None = None) -> Tensor:
        """Run all branches together.

        :param x: (n, inputs, rows, columns).
        :param channels: which input channels of the first layers ``x`` holds; the others count as
            zero. ``None``: all.
        :return: (n, 3 * limbs, rows, columns).
        """
        first, *others = self.layers()
        x = _convolve(x, first, channels)
        for convs in others:
            x = _convolve(functional.relu(x), convs, groups=len(convs))
        return x

    def one_by_one(self, x: Tensor, channels: Tensor | None = None) -> Tensor:
        """Run the branches in sequence; see :meth:`forward`."""
        outputs = []
        for branch in self.branches.values():
            first, *others = branch.children()
            assert isinstance(first, nn.Conv2d)
            y = _convolve(x, [first], channels)
            for layer in others:
                y = layer(y)
            outputs.append(y)
        return torch.cat(outputs, dim=1)


def _branch(inputs: int, layers: Layers) -> nn.Sequential:
    parts: list[nn.Module] = []
    for kernel, channels in layers:
        parts += [conv(inputs, channels, kernel), nn.ReLU()]
        inputs = channels
    return nn.Sequential(*parts, conv(inputs, N_CHANNELS, 1))


def _convolve(
    x: Tensor, convs: Sequence[nn.Conv2d], channels: Tensor | None = None, groups: int = 1
) -> Tensor:
    """Apply the convolutions of several branches as one; see :meth:`Branches.forward`."""
    weight = torch.cat([layer.weight for layer in convs])
    bias = torch.cat([layer.bias for layer in convs if layer.bias is not None])
    if channels is not None:
        weight = weight.index_select(1, channels)
    padding = convs[0].kernel_size[0] // 2
    return functional.conv2d(x, weight, bias, padding=padding, groups=groups)


class PoseNetwork(nn.Module):
    """A backbone and two stages of branches.

    :param architecture: layers of all parts.
    :param limbs: names of the limbs that have branches; ``None``: all 13.
    :raises ValueError: for an unknown limb.
    """

    def __init__(
        self, architecture: PoseArchitecture = LIGHT, limbs: Sequence[str] | None = None
    ) -> None:
        super().__init__()
        self.architecture = architecture
        self.limb_indices = limb_indices(limbs)
        self.limbs = tuple(LIMB_NAMES[limb] for limb in self.limb_indices)
        self.backbone = BACKBONES[architecture.backbone]()
        # The weights of stage 2 cover the features and the fields of all 13 limbs. A network of
        # some limbs selects the channels that it computes.
        whole = FEATURES + N_CHANNELS * N_LIMBS
        self.stage1 = Branches(self.limbs, FEATURES, architecture.stage1)
        self.stage2 = Branches(self.limbs, whole, architecture.stage2)
        fields = torch.arange(FEATURES, whole).view(N_LIMBS, N_CHANNELS)[list(self.limb_indices)]
        channels = torch.cat([torch.arange(FEATURES), fields.flatten()])
        self.register_buffer("channels", channels, persistent=False)
        self.channels: Tensor

    def forward(self, pictures: Tensor, drop: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Compute the fields of both stages.

        :param pictures: (n, 3, h, w), normalised red, green, blue; h and w multiples of 8.
        :param drop: (limbs,) limbs whose fields of stage 1 are zero for stage 2, as they are in a
            network without these limbs; for training.
        :return: two tensors (n, limbs, 3, h/8, w/8).
        """
        return self.run_stages(self.backbone(pictures), self.stage1, self.stage2, drop)

    def run_stages(
        self,
        features: Tensor,
        stage1: RunBranches,
        stage2: RunBranches,
        drop: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Compute the fields of both stages from features.

        :param features: (n, 128, h/8, w/8) of the backbone.
        :param stage1: runs the branches of stage 1.
        :param stage2: runs the branches of stage 2.
        :param drop: see :meth:`forward`.
        :return: two tensors (n, limbs, 3, h/8, w/8).
        """
        first = stage1(features, None)
        fields = first
        if drop is not None:
            fields = first * (~drop).to(first.dtype).repeat_interleave(N_CHANNELS)[:, None, None]
        second = stage2(torch.cat([features, fields], dim=1), self.stage2_channels)
        shape = (len(self.limbs), N_CHANNELS)
        return first.unflatten(1, shape), second.unflatten(1, shape)

    @property
    def stage2_channels(self) -> Tensor | None:
        """Channels of stage 2's input that the network computes; ``None`` where it has all."""
        return None if len(self.limbs) == N_LIMBS else self.channels


def field_loss(
    stages: Sequence[Tensor], truth: Tensor, mask: Tensor, heat_weight: float = 1.0
) -> Tensor:
    """Compute the squared error of all stages (eq. 4.1 to 4.3), summed over cells, mean over
    pictures.

    :param stages: each (n, limbs, 3, rows, columns).
    :param truth: (n, limbs, 3, rows, columns).
    :param mask: (n, limbs, rows, columns), 1 where the error counts.
    :param heat_weight: weight of the heat's error in equation 4.2; that of the affinities' is 1.
    """
    weights = truth.new_ones(N_CHANNELS)
    weights[HEAT] = heat_weight
    weighted = mask[:, :, None] * weights[:, None, None]
    errors = ((weighted * (fields - truth) ** 2).sum() for fields in stages)
    return sum(errors, truth.new_zeros(())) / len(truth)
