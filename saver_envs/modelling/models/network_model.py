"""Base class of the inverse models with networks: scaling, training loop and weights."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from saver_envs.modelling.arms import Task
from saver_envs.modelling.chain import FloatArray
from saver_envs.modelling.models.base import History, InverseModel, Progress, Training
from saver_envs.modelling.networks import (
    Float32,
    FrozenNetwork,
    MLPArchitecture,
    Precision,
    build_network,
)

#: A forward pass over values (n, inputs).
Frozen = Callable[[Float32], Float32]
#: Hidden layers that the paper chose for each task (Table 7.3).
PAPER_LAYERS: Final[Mapping[Task, int]] = {"ik": 3, "id": 5}
#: A channel with a smaller standard deviation counts as constant.
_CONSTANT = 1e-9


class Standardiser(NamedTuple):
    """Mean and standard deviation of every channel (Section 7.3.4).

    :param mean: (channels,).
    :param std: (channels,), above 0.
    """

    mean: FloatArray
    std: FloatArray

    @classmethod
    def of(cls, values: FloatArray) -> Standardiser:
        """Return the one that gives values (n, channels) mean 0 and variance 1."""
        std = values.std(axis=0)
        return cls(values.mean(axis=0), np.where(std < _CONSTANT, 1.0, std))

    def forward(self, values: FloatArray) -> Float32:
        """Return standardised values (n, channels)."""
        return ((values - self.mean) / self.std).astype(np.float32)

    def backward(self, values: NDArray[np.floating]) -> FloatArray:
        """Return standardised values (n, channels) in original units."""
        return values * self.std + self.mean


class NetworkModel(InverseModel):
    """A model that predicts with one network; subclasses define its training.

    :param robot: the arm's name.
    :param task: ``ik`` or ``id``.
    :param architecture: of every network of the model; the paper's by default.
    """

    def __init__(self, robot: str, task: Task, architecture: MLPArchitecture | None = None) -> None:
        super().__init__(robot, task)
        self.architecture = architecture or MLPArchitecture(layers=PAPER_LAYERS[task])
        self._input_scale = self._output_scale = Standardiser(np.zeros(1), np.ones(1))
        self._precision: Precision = "float32"
        self._device = torch.device("cpu")
        self._optimisers: list[torch.optim.Optimizer] = []
        self._weights: dict[str, Tensor] | None = None
        self._frozen: Frozen | None = None

    # What subclasses add -------------------------------------------------------------------------

    def _prepare(self, training: Training) -> nn.Module:
        """Build networks and ``_optimisers``; return the network that predicts."""
        self._network: Any = self._predictor()
        self._optimisers = [adam(self._network.parameters(), training)]
        return self._network

    @abstractmethod
    def _update(self, inputs: Tensor, outputs: Tensor) -> None:
        """Learn from one batch of standardised samples."""

    def _network_inputs(
        self, inputs: FloatArray, outputs: FloatArray, generator: np.random.Generator
    ) -> FloatArray:
        """Return the network's inputs in training."""
        return inputs

    # ---------------------------------------------------------------------------------------------

    def _fit(
        self, inputs: FloatArray, outputs: FloatArray, training: Training, progress: Progress
    ) -> History:
        """Learn; the weights of the epoch with the least validation RMSE are kept."""
        generator = np.random.default_rng(training.seed)
        inputs = self._network_inputs(inputs, outputs, generator)
        self._input_scale, self._output_scale = Standardiser.of(inputs), Standardiser.of(outputs)
        held, used = training.split(len(inputs), generator)
        torch.manual_seed(training.seed)
        self._precision, self._device = training.precision, torch.device(training.device)
        history, kept = History(), None
        for weights in self._epochs(inputs[used], outputs[used], training):
            self._frozen = self._frozen_of(weights)
            if history.add(self._forward(inputs[held]) - outputs[held]):
                kept = {name: one.detach().to("cpu", copy=True) for name, one in weights.items()}
            progress(len(history.validation_rmse) - 1, history.validation_rmse[-1])
        if kept is None:
            raise FloatingPointError(f"{self.name} diverged: no epoch has a finite error")
        self._weights, self._frozen = kept, self._frozen_of(kept)
        return history

    def _epochs(
        self, inputs: FloatArray, outputs: FloatArray, training: Training
    ) -> Iterator[Mapping[str, Tensor]]:
        """Learn; yield the weights of the predicting network after every epoch."""
        x = torch.from_numpy(self._input_scale.forward(inputs)).to(self._device)
        y = torch.from_numpy(self._output_scale.forward(outputs)).to(self._device)
        network = self._prepare(training)
        floor = training.learning_rate * training.decay
        schedules = [
            torch.optim.lr_scheduler.CosineAnnealingLR(one, training.epochs, eta_min=floor)
            for one in self._optimisers
        ]
        for _ in range(training.epochs):
            # Drawn on the CPU, the order is the same for both devices.
            for batch in torch.randperm(len(x)).to(self._device).split(training.batch_size):
                self._update(x[batch], y[batch])
            for schedule in schedules:
                schedule.step()
            yield network.state_dict()

    def _predict(self, inputs: FloatArray, present: FloatArray | None) -> FloatArray:
        return self._forward(inputs)

    def _frozen_of(self, weights: Mapping[str, Tensor]) -> Frozen:
        return FrozenNetwork(weights, self.architecture, self._input_scale, self._output_scale)

    def _forward(self, inputs: FloatArray) -> FloatArray:
        return self._fitted(self._frozen)(inputs.astype(np.float32)).astype(np.float64)

    @property
    def network_input_size(self) -> int:
        """Size of the network's input."""
        return self.input_size

    def _new_network(self, inputs: int, outputs: int) -> nn.Sequential:
        network = build_network(inputs, outputs, self.architecture, self._precision)
        return network.to(self._device)

    def _predictor(self) -> nn.Module:
        """Return a fresh network of the kind that predicts."""
        return self._new_network(self.network_input_size, self.output_size)

    def _state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        weights = self._fitted(self._weights)
        tensors = {
            f"{side}_{name}": torch.from_numpy(one)
            for side, scale in (("input", self._input_scale), ("output", self._output_scale))
            for name, one in scale._asdict().items()
        }
        tensors |= {f"network.{name}": one for name, one in weights.items()}
        return tensors, {"architecture": asdict(self.architecture)}

    def _restore(self, tensors: dict[str, Tensor], settings: dict[str, Any]) -> None:
        self.architecture = MLPArchitecture(**settings["architecture"])
        self._input_scale, self._output_scale = (
            Standardiser(tensors[f"{side}_mean"].numpy(), tensors[f"{side}_std"].numpy())
            for side in ("input", "output")
        )
        network = self._predictor()
        weights = {
            name.removeprefix("network."): one
            for name, one in tensors.items()
            if name.startswith("network.")
        }
        network.load_state_dict(weights, strict=True)
        self._weights = dict(network.state_dict())
        self._frozen = self._frozen_of(self._weights)


def adam(
    parameters: Iterable[nn.Parameter],
    training: Training,
    betas: tuple[float, float] = (0.9, 0.999),
) -> torch.optim.Adam:
    """Return Adam over parameters.

    :param parameters: on the training device.
    :param training: gives the learning rate.
    :param betas: decay rates of the moments.
    """
    return torch.optim.Adam(parameters, lr=training.learning_rate, betas=betas, fused=True)


def descend(
    optimiser: torch.optim.Optimizer, loss: Tensor, largest_gradient: float | None = None
) -> None:
    """Take one gradient step on a loss, with the gradient's norm clipped where a bound is given."""
    optimiser.zero_grad()
    loss.backward()
    if largest_gradient is not None:
        nn.utils.clip_grad_norm_(optimiser.param_groups[0]["params"], largest_gradient)
    optimiser.step()
