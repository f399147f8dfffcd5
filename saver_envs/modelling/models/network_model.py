"""What the networks among the inverse models share: scaling, the loop over batches, weights."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from saver_envs.modelling.arms import Task
from saver_envs.modelling.models.base import FloatArray, History, InverseModel, Training
from saver_envs.modelling.models.captured import own_stream, updates_from
from saver_envs.modelling.networks import (
    Architecture,
    FrozenNetwork,
    Precision,
    build_network,
)

#: A forward pass over values (n, inputs) in original units.
Frozen = Callable[[NDArray[np.float32]], NDArray[np.float32]]
#: Hidden layers that the paper chose for each task (Table 7.3).
PAPER_LAYERS: Final[Mapping[Task, int]] = {"ik": 3, "id": 5}
#: Standard deviations below this mark a channel that does not vary.
_CONSTANT = 1e-9


class Standardiser:
    """Mean and standard deviation of every channel (Section 7.3.4).

    :param mean: (channels,).
    :param std: (channels,), above 0.
    """

    def __init__(self, mean: FloatArray, std: FloatArray) -> None:
        self.mean, self.std = np.asarray(mean, np.float64), np.asarray(std, np.float64)

    @classmethod
    def of(cls, values: FloatArray) -> Standardiser:
        """Return the one that gives values (n, channels) mean 0 and variance 1."""
        std = values.std(axis=0)
        return cls(values.mean(axis=0), np.where(std < _CONSTANT, 1.0, std))

    def forward(self, values: FloatArray) -> NDArray[np.float32]:
        """Return standardised values."""
        return ((values - self.mean) / self.std).astype(np.float32)

    def backward(self, values: NDArray[np.floating]) -> FloatArray:
        """Return values in original units."""
        return values * self.std + self.mean


class NetworkModel(InverseModel):
    """A model whose prediction is one network's; subclasses say how it learns.

    :param robot: the arm's name.
    :param task: ``ik`` or ``id``.
    :param architecture: of every network of the model; the paper's by default.
    """

    def __init__(self, robot: str, task: Task, architecture: Architecture | None = None) -> None:
        super().__init__(robot, task)
        self.architecture = architecture or Architecture(layers=PAPER_LAYERS[task])
        self._input_scale = self._output_scale = Standardiser(np.zeros(1), np.ones(1))
        self._precision: Precision = "float32"
        self._device = torch.device("cpu")
        self._weights: dict[str, Tensor] | None = None
        self._frozen: Frozen | None = None

    # What subclasses add -------------------------------------------------------------------------

    @abstractmethod
    def _prepare(self, training: Training) -> nn.Module:
        """Build networks and optimisers; return the network that predicts."""

    @abstractmethod
    def _update(self, inputs: Tensor, outputs: Tensor) -> None:
        """Learn from one batch of standardised samples."""

    def _optimisers(self) -> list[torch.optim.Optimizer]:
        """The optimisers, for their learning rates to be lowered."""
        return []

    def _network_inputs(
        self, inputs: FloatArray, outputs: FloatArray, generator: np.random.Generator
    ) -> FloatArray:
        """What the network sees while it learns: the inputs, unless a subclass adds to them."""
        return inputs

    # ---------------------------------------------------------------------------------------------

    def fit(
        self,
        inputs: FloatArray,
        outputs: FloatArray,
        training: Training | None = None,
        progress: Callable[[int, float], None] | None = None,
    ) -> History:
        """Learn; the weights of the epoch with the least validation RMSE are kept."""
        training = training or Training()
        inputs, outputs = self._samples(inputs, outputs)
        generator = np.random.default_rng(training.seed)
        inputs = self._network_inputs(inputs, outputs, generator)
        self._input_scale, self._output_scale = Standardiser.of(inputs), Standardiser.of(outputs)
        order = generator.permutation(len(inputs))
        held_out = max(1, round(training.validation_share * len(inputs)))
        held, used = order[:held_out], order[held_out:]
        torch.manual_seed(training.seed)
        self._precision, self._device = training.precision, torch.device(training.device)
        samples = inputs[used], outputs[used]
        history, kept = History(), None
        with own_stream(self._device):
            for weights in self._epochs(*samples, training):
                self._frozen = self._frozen_of(weights)
                if history.add(self._forward(inputs[held]) - outputs[held]):
                    kept = {
                        name: one.detach().to("cpu", copy=True) for name, one in weights.items()
                    }
                if progress is not None:
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
        update = updates_from(self._update, x, y, training.batch_size)
        schedules = [_cosine(one, training) for one in self._optimisers()]
        for _ in range(training.epochs):
            # The order is drawn on the CPU, whose numbers are the same for both devices.
            for batch in torch.randperm(len(x)).to(self._device).split(training.batch_size):
                update(batch)
            for schedule in schedules:
                schedule.step()
            yield network.state_dict()

    def predict(self, inputs: FloatArray, present: FloatArray | None = None) -> FloatArray:
        """Return outputs; see :class:`InverseModel`."""
        return self._forward(self._checked(inputs, self.input_size, "inputs"))

    def _frozen_of(self, weights: Mapping[str, Tensor]) -> Frozen:
        scales = self._input_scale, self._output_scale
        return FrozenNetwork(weights, self.architecture, *((one.mean, one.std) for one in scales))

    def _forward(self, inputs: FloatArray) -> FloatArray:
        if self._frozen is None:
            raise ValueError(f"{self.name} of {self.robot} is not fitted")
        return self._frozen(inputs.astype(np.float32)).astype(np.float64)

    @property
    def network_input_size(self) -> int:
        """Numbers that the network reads."""
        return self.input_size

    def _new_network(self, inputs: int, outputs: int) -> nn.Sequential:
        network = build_network(inputs, outputs, self.architecture, self._precision)
        return network.to(self._device)

    def _state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        if self._weights is None:
            raise ValueError(f"{self.name} of {self.robot} is not fitted")
        scales = {
            "input_mean": self._input_scale.mean,
            "input_std": self._input_scale.std,
            "output_mean": self._output_scale.mean,
            "output_std": self._output_scale.std,
        }
        tensors = {name: torch.from_numpy(one) for name, one in scales.items()}
        tensors |= {f"network.{name}": one for name, one in self._weights.items()}
        return tensors, {"architecture": asdict(self.architecture)}

    @classmethod
    def _from_state(
        cls, robot: str, task: Task, tensors: dict[str, Tensor], settings: dict[str, Any]
    ) -> InverseModel:
        model = cls(robot, task, Architecture(**settings["architecture"]))
        scales = {
            name: tensors[name].numpy() for name in tensors if not name.startswith("network.")
        }
        model._input_scale = Standardiser(scales["input_mean"], scales["input_std"])
        model._output_scale = Standardiser(scales["output_mean"], scales["output_std"])
        network = model._network_to_load()
        weights = {
            name.removeprefix("network."): one
            for name, one in tensors.items()
            if name.startswith("network.")
        }
        network.load_state_dict(weights, strict=True)
        model._weights = dict(network.state_dict())
        model._frozen = model._frozen_of(model._weights)
        return model

    def _network_to_load(self) -> nn.Module:
        return self._new_network(self.network_input_size, self.output_size)


def adam(
    parameters: Iterable[nn.Parameter],
    training: Training,
    betas: tuple[float, float] = (0.9, 0.999),
) -> torch.optim.Adam:
    """Return Adam over parameters; on a GPU one that a CUDA graph can hold.

    :param parameters: on the device of the training.
    :param training: its learning rate and its device.
    :param betas: decay rates of the moments.
    """
    on_gpu = training.device == "cuda"
    # A graph would keep a rate that is a number as it was when it was captured.
    rate = torch.tensor(training.learning_rate, device="cuda") if on_gpu else training.learning_rate
    return torch.optim.Adam(parameters, lr=rate, betas=betas, fused=True, capturable=on_gpu)


def _cosine(
    optimiser: torch.optim.Optimizer, training: Training
) -> torch.optim.lr_scheduler.LRScheduler:
    return torch.optim.lr_scheduler.CosineAnnealingLR(
        optimiser, training.epochs, eta_min=training.learning_rate * training.decay
    )
