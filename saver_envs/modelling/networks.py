"""Build multi-layer perceptrons, and run them in NumPy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from saver_envs.validation import require

Float32 = NDArray[np.float32]
#: Mean and standard deviation of channels.
Scale = tuple[NDArray[np.float64], NDArray[np.float64]]
Activation = Literal["leaky_relu", "relu", "sigmoid"]
Precision = Literal["float32", "bfloat16"]
Device = Literal["cpu", "cuda"]

PRECISIONS: Final[tuple[Precision, ...]] = ("float32", "bfloat16")
DEVICES: Final[tuple[Device, ...]] = ("cpu", "cuda")
ACTIVATIONS: Final[tuple[Activation, ...]] = ("relu", "sigmoid", "leaky_relu")


@dataclass(frozen=True)
class MLPArchitecture:
    """A multi-layer perceptron; the defaults are the paper's for inverse kinematics.

    :param layers: number of hidden layers.
    :param width: units per hidden layer.
    :param activation: ``leaky_relu``, ``relu`` or ``sigmoid``.
    :param leak: slope of the leaky ReLU below zero.
    :raises ValueError: for a value out of range.
    """

    layers: int = 3
    width: int = 256
    activation: Activation = "leaky_relu"
    leak: float = 0.1

    def __post_init__(self) -> None:
        require("layers", self.layers, 1 <= self.layers <= 16, "1 to 16")
        require("width", self.width, 1 <= self.width <= 4096, "1 to 4096")
        known = self.activation in ACTIVATIONS
        require("activation", self.activation, known, f"one of {ACTIVATIONS}")
        require("leak", self.leak, 0 <= self.leak < 1, "at least 0 and below 1")


class Bfloat16Linear(nn.Linear):
    """A linear layer with products in bfloat16 and weights in float32."""

    def forward(self, input: Tensor) -> Tensor:
        """Return (n, outputs) in bfloat16 for (n, inputs)."""
        half = torch.bfloat16
        return functional.linear(input.to(half), self.weight.to(half), self.bias.to(half))


class Float32Linear(nn.Linear):
    """A linear layer in float32, for inputs of any precision."""

    def forward(self, input: Tensor) -> Tensor:
        """Return (n, outputs) in float32 for (n, inputs)."""
        return super().forward(input.to(self.weight.dtype))


def build_network(
    inputs: int, outputs: int, architecture: MLPArchitecture, precision: Precision = "float32"
) -> nn.Sequential:
    """Return a fresh network: hidden layers with activations, then a linear layer.

    :param inputs: size of the input.
    :param outputs: size of the output.
    :param architecture: of the hidden layers.
    :param precision: of the products between hidden layers, which take nearly all the time. Inputs,
        outputs and all weights are in float32 either way.
    """
    width = architecture.width
    between, last = (
        (Bfloat16Linear, Float32Linear) if precision == "bfloat16" else (nn.Linear, nn.Linear)
    )
    activation: nn.Module = nn.LeakyReLU(architecture.leak)
    if architecture.activation != "leaky_relu":
        activation = nn.ReLU() if architecture.activation == "relu" else nn.Sigmoid()
    layers: list[nn.Module] = [nn.Linear(inputs, width), activation]
    for _ in range(architecture.layers - 1):
        layers += [between(width, width), activation]
    return nn.Sequential(*layers, last(width, outputs))


#: Rows computed at once: few enough for their activations to stay in the CPU's cache.
_ROWS: Final = 256


class FrozenNetwork:
    """Run a network of `build_network` in NumPy, in half of torch's time for a few targets.

    :param weights: state of the network, copied.
    :param architecture: of the network.
    :param inputs: mean and standard deviation of its inputs, or None if they are standardised.
    :param outputs: mean and standard deviation of its outputs, or None if they are standardised.
    """

    def __init__(
        self,
        weights: Mapping[str, torch.Tensor],
        architecture: MLPArchitecture,
        inputs: Scale | None = None,
        outputs: Scale | None = None,
    ) -> None:
        arrays = [value.detach().cpu().numpy().astype(np.float64) for value in weights.values()]
        matrices, biases = [weight.T for weight in arrays[::2]], arrays[1::2]
        if inputs is not None:
            matrices[0] = matrices[0] / inputs[1][:, None]
            biases[0] = biases[0] - inputs[0] @ matrices[0]
        if outputs is not None:
            matrices[-1] = matrices[-1] * outputs[1]
            biases[-1] = biases[-1] * outputs[1] + outputs[0]
        self._weights = [np.ascontiguousarray(matrix, dtype=np.float32) for matrix in matrices]
        self._biases = [bias.astype(np.float32) for bias in biases]
        self._kind = architecture.activation
        self._leak = np.float32(architecture.leak if self._kind == "leaky_relu" else 0.0)

    def __call__(self, values: Float32) -> Float32:
        """Return outputs (n, outputs) for inputs (n, inputs)."""
        if len(values) <= _ROWS:
            return self._part(values)
        starts = range(0, len(values), _ROWS)
        return np.concatenate([self._part(values[start : start + _ROWS]) for start in starts])

    def _part(self, values: Float32) -> Float32:
        *hidden, (last, last_bias) = zip(self._weights, self._biases, strict=True)
        for weight, bias in hidden:
            values = values @ weight
            values += bias
            if self._kind == "sigmoid":
                np.negative(values, out=values)
                np.exp(values, out=values)
                values += np.float32(1)
                np.reciprocal(values, out=values)
            else:
                np.maximum(values, values * self._leak, out=values)
        return values @ last + last_bias
