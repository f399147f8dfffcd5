"""Forward passes of frozen policies in NumPy.

For the few rows that a teacher computes at every step, NumPy takes half of torch's time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from saver_advisors.policies.networks import PolicyNetworks

FloatArray = NDArray[np.float32]
Activation = Callable[[FloatArray], FloatArray]


class FrozenPolicy:
    """Run the normaliser, actor and critics of `PolicyNetworks`.

    Actions are in the units of the environment in which the policy was trained.

    :param networks: the weights, which are copied.
    :param name: of the policy, for messages.
    """

    def __init__(self, networks: PolicyNetworks, name: str = "policy") -> None:
        self.spec = networks.spec
        self.name = name
        self._mean, self._std, self._clip = (
            _copy(values) for values in (networks.mean, networks.std, networks.clip)
        )
        self._low = _copy(networks.action_low)
        self._span = _copy(networks.action_high) - self._low
        self._actor = _layers(networks.actor)
        critics = [_layers(critic) for critic in networks.critics]
        self._first_critic = critics[0] if critics else []
        # One stacked product is faster than several products in sequence.
        self._critics = [_together(list(alike)) for alike in zip(*critics, strict=True)]

    def features(self, inputs: Mapping[str, NDArray[Any] | None]) -> FloatArray:
        """Concatenate and normalise.

        :param inputs: each input of the spec, (n, its size).
        :return: (n, feature_size), (x - mean) / std, clipped.
        :raises ValueError: if an input is missing or its shape differs.
        """
        parts = [
            check_rows(key, inputs.get(key), size, self.name) for key, size in self.spec.inputs
        ]
        flat: FloatArray = np.concatenate(parts, axis=1, dtype=np.float32, casting="same_kind")
        flat -= self._mean
        flat /= self._std
        np.maximum(flat, -self._clip, out=flat)
        return np.minimum(flat, self._clip, out=flat)

    def action(self, features: FloatArray) -> FloatArray:
        """Return the deterministic action, (n, action_size)."""
        scaled = np.tanh(_forward(self._actor, features))
        return self._low + np.float32(0.5) * (scaled + np.float32(1.0)) * self._span

    def q_value(
        self, features: FloatArray, action: FloatArray, *, twin_minimum: bool
    ) -> FloatArray:
        """Return the critics' value of an action.

        :param features: (n, feature_size).
        :param action: (n, action_size).
        :param twin_minimum: whether to return the minimum of the critics, else the first.
        :return: (n,).
        """
        scaled = np.float32(2.0) * (action - self._low) / self._span - np.float32(1.0)
        joined = np.concatenate((features, scaled), axis=1)
        if not twin_minimum:
            return _mean(_forward(self._first_critic, joined))
        return _mean(_forward(self._critics, joined)).min(axis=0)


@dataclass(frozen=True)
class _Layer:
    """A linear layer, optionally followed by LayerNorm and activation; or those of k networks.

    :param weight: (in, out), or (k, in, out).
    :param bias: (out,), or (k, 1, out).
    :param norm: LayerNorm's weight and bias, shaped as ``bias``, and its eps.
    :param activation: in place where NumPy can.
    """

    weight: FloatArray
    bias: FloatArray
    norm: tuple[FloatArray, FloatArray, float] | None
    activation: Activation | None


def check_rows(key: str, values: NDArray[Any] | None, size: int, name: str) -> NDArray[Any]:
    """Check that an input is given and has the shape (n, size).

    :param key: of the input, for the message.
    :param values: the input.
    :param size: numbers per row.
    :param name: of the policy, for the message.
    :return: the input.
    :raises ValueError: if it is missing or has another shape.
    """
    if values is None:
        raise ValueError(f"{name!r} reads {key!r}, which the observation lacks: pass it too")
    if values.ndim != 2 or values.shape[1] != size:
        raise ValueError(f"{key} has shape {values.shape}: {name!r} needs (n, {size})")
    return values


def _copy(values: torch.Tensor) -> FloatArray:
    return values.detach().numpy().astype(np.float32)


def _layers(network: nn.Module) -> list[_Layer]:
    """Return the layers of a multi-layer perceptron of `PolicyNetworks`."""
    layers: list[_Layer] = []
    for module in network.children():
        if isinstance(module, nn.Linear):
            # (in, out), row by row: as the product reads it.
            weight = np.ascontiguousarray(_copy(module.weight).T)
            layers.append(_Layer(weight, _copy(module.bias), None, None))
            continue
        last = layers.pop()
        if isinstance(module, nn.LayerNorm):
            norm = _copy(module.weight), _copy(module.bias), module.eps
            # LayerNorm subtracts the mean; subtracting it from the weights saves that step.
            weight = last.weight - last.weight.mean(axis=1, keepdims=True)
            layers.append(_Layer(weight, last.bias - last.bias.mean(), norm, None))
        else:
            layers.append(replace(last, activation=_activation(module)))
    return layers


def _together(layers: list[_Layer]) -> _Layer:
    """Combine the same layer of several networks into one."""
    first = layers[0]

    def stack(parts: list[FloatArray]) -> FloatArray:
        return np.stack(parts)[:, np.newaxis]

    norms = [layer.norm for layer in layers if layer.norm is not None]
    norm = None
    if norms:
        norm = stack([one[0] for one in norms]), stack([one[1] for one in norms]), norms[0][2]
    weight = np.stack([layer.weight for layer in layers])
    return _Layer(weight, stack([layer.bias for layer in layers]), norm, first.activation)


def _mean(values: FloatArray) -> FloatArray:
    """Average a critic's outputs, (..., n) -> (...)."""
    return values[..., 0] if values.shape[-1] == 1 else values.mean(axis=-1)


def _forward(layers: list[_Layer], values: FloatArray) -> FloatArray:
    for layer in layers:
        values = values @ layer.weight
        values += layer.bias
        if layer.norm is not None:
            _normalise(values, *layer.norm)
        if layer.activation is not None:
            values = layer.activation(values)
    return values


def _normalise(values: FloatArray, weight: FloatArray, bias: FloatArray, eps: float) -> None:
    """Apply LayerNorm in place to rows whose mean is zero."""
    scale = np.vecdot(values, values)[..., np.newaxis]
    scale /= np.float32(values.shape[-1])
    scale += np.float32(eps)
    values *= np.float32(1.0) / np.sqrt(scale)
    values *= weight
    values += bias


_OWN: Final[Mapping[type[nn.Module], Activation]] = {
    nn.ReLU: lambda values: np.maximum(values, np.float32(0.0), out=values),
    nn.Tanh: lambda values: np.tanh(values, out=values),
}
"""Activations in NumPy; the others run in torch on the same memory."""


def _activation(module: nn.Module) -> Activation:
    if type(module) in _OWN:
        return _OWN[type(module)]

    def of_torch(values: FloatArray) -> FloatArray:
        with torch.inference_mode():
            return module(torch.from_numpy(values)).numpy()

    return of_torch
