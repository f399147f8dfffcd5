"""Interface of inverse models (fit, predict, save) and settings of their training."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Final, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from saver_envs.modelling.arms import TASK_NAMES, Task, arm_named
from saver_envs.modelling.chain import FloatArray
from saver_envs.modelling.networks import DEVICES, PRECISIONS, Device, Precision
from saver_envs.validation import require
from saver_envs.weights import check_finite, write_weights

T = TypeVar("T")
#: Called with each epoch and its validation RMSE.
Progress = Callable[[int, float], None]

TASKS: Final[tuple[Task, ...]] = ("ik", "id")
KIND: Final = "saver-inverse-model"


@dataclass(frozen=True)
class Training:
    """Settings of a training run; the defaults are the paper's where it states them.

    :param epochs: passes over the training samples.
    :param batch_size: samples per update; not stated in the paper.
    :param learning_rate: of Adam.
    :param decay: ratio of the last epoch's learning rate to the first's, on a cosine.
    :param validation_share: fraction of the samples held out for validation, drawn at random.
    :param sigma: standard deviation of the fake inputs around the real ones, in standardised units
        (0, 0.2, 0.4 or 0.6 in the paper); only for adversarial models.
    :param supervised_weight: weight of a squared error added to the generator's loss; 0 in the
        paper's equations; only for adversarial models.
    :param loop_weight: weight of the loops in the losses of ``bigan`` and ``dualgan``; not stated
        in the paper. Any two generators that invert each other minimise the loops, regardless of
        the data. Only the discriminators tie the generators to the data, and a large weight makes
        their gradients negligible.
    :param precision: of the products between hidden layers, ``float32`` or ``bfloat16``: the
        latter takes two thirds of the time on a processor that supports it (AVX-512 BF16, AMX) and
        much more on others. Weights and predictions are in float32 either way.
    :param device: on which networks learn, ``cpu`` or ``cuda``; models predict on the CPU. From a
        seed, weights, split and order are the same on both; the noise of the fake inputs is not.
    :param seed: of weights, split, order and noise.
    :raises ValueError: for a value out of range, or ``cuda`` without a GPU.
    """

    epochs: int = 100
    batch_size: int = 256
    learning_rate: float = 1e-3
    decay: float = 0.05
    validation_share: float = 0.2
    sigma: float = 0.0
    supervised_weight: float = 0.0
    loop_weight: float = 0.1
    seed: int = 0
    precision: Precision = "float32"
    device: Device = "cpu"

    def __post_init__(self) -> None:
        checks = {
            "epochs": (self.epochs >= 1, "at least 1"),
            "batch_size": (self.batch_size >= 1, "at least 1"),
            "learning_rate": (0 < self.learning_rate < 1, "between 0 and 1"),
            "decay": (0 < self.decay <= 1, "above 0 and at most 1"),
            "validation_share": (0 < self.validation_share < 1, "between 0 and 1"),
            "sigma": (0 <= self.sigma < np.inf, "at least 0"),
            "supervised_weight": (0 <= self.supervised_weight < np.inf, "at least 0"),
            "loop_weight": (0 <= self.loop_weight < np.inf, "at least 0"),
            "precision": (self.precision in PRECISIONS, f"one of {', '.join(PRECISIONS)}"),
            "device": (self.device in DEVICES, f"one of {', '.join(DEVICES)}"),
        }
        for name, (holds, valid) in checks.items():
            require(name, getattr(self, name), holds, valid)
        if self.device == "cuda" and not torch.cuda.is_available():
            raise ValueError(
                f"device='cuda': torch {torch.__version__} finds no GPU; use device='cpu'"
            )

    def split(
        self, count: int, generator: np.random.Generator
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return the indices of the validation samples, at least one, and the training samples."""
        order = generator.permutation(count)
        held_out = max(1, round(self.validation_share * count))
        return order[:held_out], order[held_out:]


@dataclass
class History:
    """Validation errors of a training run.

    :param validation_rmse: root mean square error after every epoch, in original units.
    :param best_epoch: index of the epoch whose weights are kept.
    :param per_output: root mean square error of each output at that epoch.
    """

    validation_rmse: list[float] = field(default_factory=list)
    best_epoch: int = 0
    per_output: list[float] = field(default_factory=list)

    def add(self, error: FloatArray) -> bool:
        """Record the errors (n, outputs) of an epoch; return whether it is the best so far."""
        square = np.square(error).mean(axis=0)
        rmse = float(np.sqrt(square.mean()))
        best = np.isfinite(rmse) and rmse < min(self.validation_rmse, default=np.inf)
        self.validation_rmse.append(rmse)
        if best:
            self.best_epoch = len(self.validation_rmse) - 1
            self.per_output = np.sqrt(square).tolist()
        return bool(best)


class InverseModel(ABC):
    """Maps targets to joints (inverse kinematics) or motions to torques (inverse dynamics).

    :param robot: the arm's name.
    :param task: ``ik`` or ``id``.
    :raises ValueError: for an unknown arm or a task that the model does not solve.
    """

    name: ClassVar[str]
    #: Whether `predict` needs the present joints.
    needs_present: ClassVar[bool] = False
    #: Tasks that the model solves.
    tasks: ClassVar[tuple[Task, ...]] = TASKS

    def __init__(self, robot: str, task: Task) -> None:
        self.arm = arm_named(robot)
        require("task", task, task in TASKS, f"one of {', '.join(TASKS)}")
        if task not in self.tasks:
            only = TASK_NAMES[self.tasks[0]]
            raise ValueError(f"task={task!r}: {self.name!r} is only for {only}")
        self.robot, self.task = robot, task

    @property
    def input_size(self) -> int:
        """Size of an input: a target, or position, velocity and acceleration of the joints."""
        return self.arm.target_size if self.task == "ik" else 3 * self.arm.dof

    @property
    def output_size(self) -> int:
        """Size of an output: one number per joint."""
        return self.arm.dof

    def fit(
        self,
        inputs: FloatArray,
        outputs: FloatArray,
        training: Training | None = None,
        progress: Progress | None = None,
    ) -> History:
        """Learn from samples in temporal order.

        :param inputs: (n, input_size), original units.
        :param outputs: (n, output_size).
        :param training: settings; the defaults if None.
        :param progress: called with each epoch and its validation RMSE.
        :return: validation errors.
        :raises ValueError: for mismatched shapes, or values that are not finite.
        """
        inputs = self._checked(inputs, self.input_size, "inputs")
        outputs = self._checked(outputs, self.output_size, "outputs")
        if len(inputs) != len(outputs) or len(inputs) < 2:
            raise ValueError(
                f"{len(inputs)} inputs and {len(outputs)} outputs: must be equally many, at least 2"
            )
        return self._fit(inputs, outputs, training or Training(), progress or (lambda *_: None))

    def predict(self, inputs: FloatArray, present: FloatArray | None = None) -> FloatArray:
        """Return outputs (n, output_size) in original units.

        :param inputs: (n, input_size).
        :param present: (n, dof) present joints, for inverse kinematics; required if
            ``needs_present``.
        :raises ValueError: for a wrong shape, or a model that is not fitted.
        """
        return self._predict(self._checked(inputs, self.input_size, "inputs"), present)

    @abstractmethod
    def _fit(
        self, inputs: FloatArray, outputs: FloatArray, training: Training, progress: Progress
    ) -> History:
        """Learn from checked samples; see :meth:`fit`."""

    @abstractmethod
    def _predict(self, inputs: FloatArray, present: FloatArray | None) -> FloatArray:
        """Return outputs for checked inputs; see :meth:`predict`."""

    def _state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Return the tensors and settings that define the model; none if nothing is learned."""
        return {}, {}

    @abstractmethod
    def _restore(self, tensors: dict[str, Tensor], settings: dict[str, Any]) -> None:
        """Become the model that :meth:`_state` describes."""

    def save(self, path: Path, card: Mapping[str, Any] | None = None) -> None:
        """Write a weight file.

        :param path: must end in ``.safetensors``.
        :param card: where the model comes from; JSON-able.
        :raises ValueError: for another ending, or weights that are not finite.
        """
        path = Path(path)
        if path.suffix != ".safetensors":
            raise ValueError(f"path={str(path)!r} must end in '.safetensors'")
        tensors, settings = self._state()
        check_finite(path, tensors)
        header = {
            "model": self.name,
            "robot": self.robot,
            "task": self.task,
            "settings": json.dumps(settings),
            "card": json.dumps(dict(card or {})),
        }
        path.parent.mkdir(parents=True, exist_ok=True)
        # safetensors rejects a file without tensors as incomplete.
        write_weights(path, KIND, tensors or {"nothing": torch.zeros(1)}, header)

    def _fitted(self, part: T | None) -> T:
        """Return a part that fitting or loading creates, or raise ValueError."""
        if part is None:
            raise ValueError(f"{self.name} of {self.robot} is not fitted")
        return part

    def _checked(self, values: FloatArray, size: int, name: str) -> FloatArray:
        values = np.asarray(values, dtype=np.float64)
        if values.ndim != 2 or values.shape[1] != size:
            raise ValueError(
                f"{name} of shape {values.shape}: {self.robot} {self.task} needs (n, {size})"
            )
        if not np.isfinite(values).all():
            raise ValueError(f"{name}: every value must be finite")
        return values
