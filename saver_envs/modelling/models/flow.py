"""A normalising flow over joints, conditioned on the target: a modern alternative to the GANs.

Coupling layers (RealNVP; Dinh et al., 2017) turn a normal variable into joints, conditioned on the
target, and learn by maximum likelihood, as in IKFlow (Ames et al., 2022). A regressor averages over
solutions; a flow separates them, and of several draws the one nearest to the present joints is
used.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from saver_envs.modelling.arms import Task
from saver_envs.modelling.chain import FloatArray
from saver_envs.modelling.models.network_model import NetworkModel, descend
from saver_envs.modelling.networks import Float32, FrozenNetwork, MLPArchitecture, build_network

#: Coupling layers, and the perceptron in each.
COUPLINGS = 6
_ARCHITECTURE = MLPArchitecture(layers=2, width=128)
#: Bound of the log scales, and of the gradient's norm.
_LARGEST_LOG_SCALE, _LARGEST_GRADIENT = 2.0, 10.0
#: Noise on the standardised joints in training: they lie on a thin set with unbounded density.
_SOFTENING = 0.02
#: Draws among which the one nearest to the present joints is chosen.
DRAWS = 16


class ConditionalFlow(nn.Module):
    """Coupling layers between joints and a normal variable.

    :param condition: size of the target.
    :param size: number of joints, at least 2.
    :param architecture: of the perceptrons.
    """

    def __init__(self, condition: int, size: int, architecture: MLPArchitecture) -> None:
        super().__init__()
        self.nets = nn.ModuleList()
        for layer in range(COUPLINGS):
            read, given = (len(range(size)[half]) for half in halves(size, layer))
            self.nets.append(build_network(condition + read, 2 * given, architecture))
            nn.init.zeros_(self.nets[-1][-1].weight)  # type: ignore[index]
        self._size = size

    def log_likelihood(self, values: Tensor, condition: Tensor) -> Tensor:
        """Return log p(values | condition), (n,), up to a constant."""
        total = values.new_zeros(len(values))
        for layer, net in enumerate(self.nets):
            kept, changed = halves(self._size, layer)
            shift, raw = net(torch.cat([condition, values[:, kept]], dim=1)).chunk(2, dim=1)
            log_scale = _LARGEST_LOG_SCALE * torch.tanh(raw)
            values = values.clone()
            values[:, changed] = (values[:, changed] - shift) * torch.exp(-log_scale)
            total = total - log_scale.sum(dim=1)
        return total - 0.5 * values.square().sum(dim=1)


def halves(size: int, layer: int) -> tuple[slice, slice]:
    """Return the entries that a layer reads, and those that it changes."""
    even, odd = slice(0, size, 2), slice(1, size, 2)
    return (even, odd) if layer % 2 == 0 else (odd, even)


class FrozenFlow:
    """The flow from normal variables to joints, in NumPy.

    :param weights: state of a `ConditionalFlow`, copied.
    :param architecture: of its perceptrons.
    :param size: number of joints.
    """

    def __init__(
        self, weights: Mapping[str, Tensor], architecture: MLPArchitecture, size: int
    ) -> None:
        parts: list[dict[str, Tensor]] = [{} for _ in range(COUPLINGS)]
        for name, one in weights.items():  # such as nets.3.0.weight
            parts[int(name.split(".")[1])][name] = one
        self._nets = [FrozenNetwork(part, architecture) for part in parts]
        self._size = size

    def __call__(self, condition: Float32, normal: Float32 | None = None) -> Float32:
        """Return joints (n, size) for conditions (n, ...) and normal variables (n, size) or 0."""
        shape = (len(condition), self._size)
        values = np.zeros(shape, np.float32) if normal is None else normal.copy()
        for layer in reversed(range(COUPLINGS)):
            kept, changed = halves(self._size, layer)
            both = self._nets[layer](np.concatenate([condition, values[:, kept]], axis=1))
            shift, raw = np.split(both, 2, axis=1)
            scale = np.exp(np.float32(_LARGEST_LOG_SCALE) * np.tanh(raw))
            values[:, changed] = values[:, changed] * scale + shift
        return values


class Flow(NetworkModel):
    """Joints as draws of a conditional flow; without present joints the draw at 0.

    :raises ValueError: for inverse dynamics, which has a single solution.
    """

    name: ClassVar[str] = "flow"
    tasks: ClassVar[tuple[Task, ...]] = ("ik",)

    def __init__(self, robot: str, task: Task, architecture: MLPArchitecture | None = None) -> None:
        super().__init__(robot, task, architecture or _ARCHITECTURE)
        # The same draws for every target make predictions deterministic.
        self._draws = (
            np.random.default_rng(0).standard_normal((DRAWS, self.output_size)).astype(np.float32)
        )
        self._draws[0] = 0.0

    def _predictor(self) -> ConditionalFlow:
        flow = ConditionalFlow(self.input_size, self.output_size, self.architecture)
        return flow.to(self._device)

    def _update(self, inputs: Tensor, outputs: Tensor) -> None:
        softened = outputs + _SOFTENING * torch.randn_like(outputs)
        loss = -self._network.log_likelihood(softened, inputs).mean()
        descend(self._optimisers[0], loss, _LARGEST_GRADIENT)

    def _frozen_of(self, weights: Mapping[str, Tensor]) -> FrozenFlow:
        return FrozenFlow(weights, self.architecture, self.output_size)

    def _forward(self, inputs: FloatArray) -> FloatArray:
        frozen = self._fitted(self._frozen)
        return self._output_scale.backward(frozen(self._input_scale.forward(inputs)))

    def _predict(self, inputs: FloatArray, present: FloatArray | None) -> FloatArray:
        """Return joints (n, dof): the draw nearest to the present joints, if given."""
        if present is None:
            return self._forward(inputs)
        present = self._checked(present, self.output_size, "present")
        frozen: Any = self._fitted(self._frozen)
        condition = np.repeat(self._input_scale.forward(inputs), DRAWS, axis=0)
        joints = frozen(condition, np.tile(self._draws, (len(inputs), 1)))
        joints = self._output_scale.backward(joints).reshape(len(inputs), DRAWS, -1)
        best = np.square(joints - present[:, None]).sum(axis=-1).argmin(axis=1)
        return np.asarray(joints[np.arange(len(inputs)), best])
