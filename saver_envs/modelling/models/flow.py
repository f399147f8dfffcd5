"""A normalising flow over joints, given the target: today's peer of the adversarial models.

Coupling layers (RealNVP; Dinh et al., 2017) turn a normal variable into joints, conditioned on the
target, and learn by maximum likelihood, as IKFlow does (Ames et al., 2022). It keeps the answers
apart that a regressor averages: from several draws the one nearest to the present joints is taken.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from saver_envs.modelling.arms import Task
from saver_envs.modelling.models.base import FloatArray, Training
from saver_envs.modelling.models.network_model import NetworkModel, adam
from saver_envs.modelling.networks import Architecture, Float32, FrozenNetwork, build_network

#: Coupling layers, and the perceptron in each.
COUPLINGS = 6
_ARCHITECTURE = Architecture(layers=2, width=128)
#: Log scales stay within this bound.
_LARGEST_LOG_SCALE = 2.0
#: Noise on the standardised joints in training: they lie on a thin set, whose density has no bound.
_SOFTENING = 0.02
#: Draws among which the one nearest to the present joints is chosen.
DRAWS = 16


class ConditionalFlow(nn.Module):
    """Coupling layers between joints and a normal variable.

    :param condition: numbers of the target.
    :param size: numbers of the joints, at least 2.
    :param architecture: of the perceptrons.
    """

    def __init__(self, condition: int, size: int, architecture: Architecture) -> None:
        super().__init__()
        self.nets = nn.ModuleList()
        for layer in range(COUPLINGS):
            read, given = (len(range(size)[half]) for half in halves(size, layer))
            self.nets.append(build_network(condition + read, 2 * given, architecture))
            nn.init.zeros_(self.nets[-1][-1].weight)  # type: ignore[index]
        self._size = size

    def log_likelihood(self, values: Tensor, condition: Tensor) -> Tensor:
        """Return log p(values | condition), (n,), less a constant."""
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
    """Return which entries a layer reads, and which it changes."""
    even, odd = slice(0, size, 2), slice(1, size, 2)
    return (even, odd) if layer % 2 == 0 else (odd, even)


class FrozenFlow:
    """The flow from normal variables to joints, in NumPy.

    :param weights: the state of a `ConditionalFlow`, copied.
    :param architecture: of its perceptrons.
    :param size: numbers of the joints.
    """

    def __init__(
        self, weights: Mapping[str, Tensor], architecture: Architecture, size: int
    ) -> None:
        self._nets = [
            FrozenNetwork(
                {name: one for name, one in weights.items() if name.startswith(f"nets.{layer}.")},
                architecture,
            )
            for layer in range(COUPLINGS)
        ]
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

    :raises ValueError: for inverse dynamics, whose answer is one.
    """

    name: ClassVar[str] = "flow"

    def __init__(self, robot: str, task: Task, architecture: Architecture | None = None) -> None:
        if task != "ik":
            raise ValueError(f"task={task!r}: 'flow' is for inverse kinematics alone")
        super().__init__(robot, task, architecture or _ARCHITECTURE)
        # The same draws for every target: a prediction is a function.
        self._draws = (
            np.random.default_rng(0).standard_normal((DRAWS, self.output_size)).astype(np.float32)
        )
        self._draws[0] = 0.0

    def _prepare(self, training: Training) -> nn.Module:
        flow = ConditionalFlow(self.input_size, self.output_size, self.architecture)
        self._flow = flow.to(self._device)
        self._adam = adam(self._flow.parameters(), training)
        return self._flow

    def _optimisers(self) -> list[torch.optim.Optimizer]:
        return [self._adam]

    def _update(self, inputs: Tensor, outputs: Tensor) -> None:
        softened = outputs + _SOFTENING * torch.randn_like(outputs)
        loss = -self._flow.log_likelihood(softened, inputs).mean()
        self._adam.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self._flow.parameters(), 10.0)
        self._adam.step()

    def _frozen_of(self, weights: Mapping[str, Tensor]) -> FrozenFlow:
        return FrozenFlow(weights, self.architecture, self.output_size)

    def _forward(self, inputs: FloatArray) -> FloatArray:
        if self._frozen is None:
            raise ValueError(f"{self.name} of {self.robot} is not fitted")
        return self._output_scale.backward(self._frozen(self._input_scale.forward(inputs)))

    def _network_to_load(self) -> nn.Module:
        return ConditionalFlow(self.input_size, self.output_size, self.architecture)

    def predict(self, inputs: FloatArray, present: FloatArray | None = None) -> FloatArray:
        """Return joints (n, dof): of the draws the nearest to the present ones, if given."""
        inputs = self._checked(inputs, self.input_size, "inputs")
        if present is None:
            return self._forward(inputs)
        present = self._checked(present, self.output_size, "present")
        frozen = self._frozen
        if not isinstance(frozen, FrozenFlow):
            raise ValueError(f"{self.name} of {self.robot} is not fitted")
        n = len(inputs)
        condition = np.repeat(self._input_scale.forward(inputs), DRAWS, axis=0)
        joints = self._output_scale.backward(frozen(condition, np.tile(self._draws, (n, 1))))
        joints = joints.reshape(n, DRAWS, -1)
        best = np.square(joints - present[:, None]).sum(axis=-1).argmin(axis=1)
        return joints[np.arange(n), best]

    def sample(self, inputs: FloatArray, draws: int, generator: np.random.Generator) -> FloatArray:
        """Return joints (n, draws, dof) that the flow holds likely for inputs (n, input_size)."""
        inputs = self._checked(inputs, self.input_size, "inputs")
        frozen: Any = self._frozen
        if frozen is None:
            raise ValueError(f"{self.name} of {self.robot} is not fitted")
        condition = np.repeat(self._input_scale.forward(inputs), draws, axis=0)
        normal = generator.standard_normal((len(condition), self.output_size)).astype(np.float32)
        joints = self._output_scale.backward(frozen(condition, normal))
        return joints.reshape(len(inputs), draws, -1)
