"""What every inverse model can do: fit, predict, save; and how it is trained."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.torch import save as to_bytes
from torch import Tensor

from saver_envs.files import written_whole
from saver_envs.modelling.arms import Arm, Task, arm_named
from saver_envs.modelling.networks import DEVICES, PRECISIONS, Device, Precision

FloatArray = NDArray[np.float64]

TASKS: Final[tuple[Task, ...]] = ("ik", "id")
FORMAT: Final = "saver-inverse-model-1"


@dataclass(frozen=True)
class Training:
    """How a model is trained; the defaults are the paper's where it names them.

    :param epochs: passes over the training share.
    :param batch_size: samples of an update. The paper names none.
    :param learning_rate: of Adam.
    :param decay: the learning rate of the last epoch as a share of the first, on a cosine.
    :param validation_share: of the samples, drawn at random, that train nothing.
    :param sigma: standard deviation of the fake inputs round the real ones, in the standardised
        units of the channels (0, 0.2, 0.4 or 0.6 in the paper); adversarial models alone.
    :param supervised_weight: of the squared error that is added to the generator's loss; 0 in the
        paper's equations; adversarial models alone.
    :param loop_weight: of the loops in the losses of ``bigan`` and ``dualgan``. The paper names
        none, and any two generators that undo each other meet them, whatever the data: too great a
        weight drowns the discriminators, which alone tie the generators to the data.
    :param precision: of the products between hidden layers, ``float32`` or ``bfloat16``: the
        latter takes two thirds of the time on a processor that has it (AVX-512 BF16, AMX) and much
        more on one that has not. Weights and predictions are in float32 either way.
    :param device: that the networks learn on, ``cpu`` or ``cuda``. Models predict on the CPU. From
        a seed, weights, split and order are the same on both; the noise of the fake inputs is not.
    :param seed: of weights, split, order and noise.
    :raises ValueError: for a value out of range, or a GPU where there is none.
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
            if not holds:
                raise ValueError(f"{name}={getattr(self, name)!r}: must be {valid}")
        if self.device == "cuda" and not torch.cuda.is_available():
            raise ValueError(
                f"device='cuda': torch {torch.__version__} sees no GPU here; 'cpu' would do"
            )


@dataclass
class History:
    """What a training run was like.

    :param validation_rmse: after every epoch, in original units.
    :param best_epoch: from 0, that of the weights which are kept.
    :param per_output: at that epoch, of each output.
    """

    validation_rmse: list[float] = field(default_factory=list)
    best_epoch: int = 0
    per_output: list[float] = field(default_factory=list)

    def add(self, error: FloatArray) -> bool:
        """Note the errors (n, outputs) of an epoch; say whether it is the best so far."""
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
    :raises ValueError: for an unknown arm or task.
    """

    name: ClassVar[str]
    #: Whether `predict` needs the present joints.
    needs_present: ClassVar[bool] = False

    def __init__(self, robot: str, task: Task) -> None:
        self.arm: Arm = arm_named(robot)
        if task not in TASKS:
            raise ValueError(f"task={task!r}: must be one of {', '.join(TASKS)}")
        self.robot, self.task = robot, task

    @property
    def input_size(self) -> int:
        """Numbers of an input: a target's, or three times the joints'."""
        return self.arm.target_size if self.task == "ik" else 3 * self.arm.dof

    @property
    def output_size(self) -> int:
        """Numbers of an output: one a joint."""
        return self.arm.dof

    @abstractmethod
    def fit(
        self,
        inputs: FloatArray,
        outputs: FloatArray,
        training: Training | None = None,
        progress: Callable[[int, float], None] | None = None,
    ) -> History:
        """Learn from samples in the order of time.

        :param inputs: (n, input_size), original units.
        :param outputs: (n, output_size).
        :param training: how; the defaults if None.
        :param progress: is told each epoch and its validation RMSE.
        :raises ValueError: for shapes that do not fit, or values that are not finite.
        """

    @abstractmethod
    def predict(self, inputs: FloatArray, present: FloatArray | None = None) -> FloatArray:
        """Return outputs (n, output_size) in original units.

        :param inputs: (n, input_size).
        :param present: (n, dof) the joints now; inverse kinematics alone, and only where
            ``needs_present`` says so must it be given.
        :raises ValueError: for shapes that do not fit, or a model that is not fitted.
        """

    @abstractmethod
    def _state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Tensors and settings that make the model."""

    @classmethod
    @abstractmethod
    def _from_state(
        cls, robot: str, task: Task, tensors: dict[str, Tensor], settings: dict[str, Any]
    ) -> InverseModel:
        """Make the model again."""

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
        for name, value in tensors.items():
            if not torch.isfinite(value).all():
                raise ValueError(f"{name} holds values that are not finite")
        header = {
            "format": FORMAT,
            "model": self.name,
            "robot": self.robot,
            "task": self.task,
            "settings": json.dumps(settings),
            "card": json.dumps(dict(card or {})),
        }
        path.parent.mkdir(parents=True, exist_ok=True)
        # A file without any tensor would be refused as cut short.
        content = tensors or {"nothing": torch.zeros(1)}
        whole = {name: one.contiguous() for name, one in content.items()}
        with written_whole(path) as file:
            file.write(to_bytes(whole, header))

    def _checked(self, values: FloatArray, size: int, name: str) -> FloatArray:
        values = np.asarray(values, dtype=np.float64)
        if values.ndim != 2 or values.shape[1] != size:
            raise ValueError(
                f"{name} of shape {values.shape}: {self.robot} {self.task} needs (n, {size})"
            )
        if not np.isfinite(values).all():
            raise ValueError(f"{name}: every value must be finite")
        return values

    def _samples(self, inputs: FloatArray, outputs: FloatArray) -> tuple[FloatArray, FloatArray]:
        inputs = self._checked(inputs, self.input_size, "inputs")
        outputs = self._checked(outputs, self.output_size, "outputs")
        if len(inputs) != len(outputs) or len(inputs) < 2:
            raise ValueError(
                f"{len(inputs)} inputs and {len(outputs)} outputs: must be as many, at least 2"
            )
        return inputs, outputs
