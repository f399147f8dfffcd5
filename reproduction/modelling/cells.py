"""One cell of the grid of chapter 7: a model trained on so much data, and all that is measured."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from statistics import median
from typing import Any, Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Task = Literal["ik", "id"]
Precision = Literal["float32", "bfloat16"]
Device = Literal["cpu", "cuda"]

PRECISIONS: Final[tuple[Precision, ...]] = get_args(Precision)
DEVICES: Final[tuple[Device, ...]] = get_args(Device)

SAMPLES_A_SIZE: Final = 10_000
"""Size k is the first k x 10,000 consecutive samples."""

SIZES: Final = (1, 2, 3, 4, 5, 6)
SIGMAS: Final = (0.0, 0.2, 0.4, 0.6)

PAPER_EPOCHS: Final = 100
"""What the paper trains for."""

REFINED: Final = 2
"""Newton steps behind a network, for the refined figures."""

_TASK_SPACE_ROWS: Final = 6000
_LARGE_BATCH: Final = 4096
_LATENCY_CALLS: Final = 300


@dataclass(frozen=True)
class Cell:
    """What is trained, and on what; everything that its result depends on.

    :param robot: the arm's name
    :param task: "ik" or "id"
    :param model: its name
    :param size: tens of thousands of samples
    :param sigma: of the fake inputs; 0 for models that are not adversarial
    :param seed: of split, weights and noise
    :param epochs: of the training
    :param supervised_weight: of the squared error in an adversarial model's loss
    :param precision: of the products while training
    :param data_seed: of the data set
    :param device: that trains
    """

    robot: str
    task: Task
    model: str
    size: int
    sigma: float
    seed: int
    epochs: int = PAPER_EPOCHS
    supervised_weight: float = 0.0
    precision: Precision = "float32"
    data_seed: int = 0
    device: Device = "cpu"

    @property
    def file_name(self) -> str:
        """The name of its JSON file."""
        supervised = f"-supervised{self.supervised_weight:g}" if self.supervised_weight else ""
        epochs = f"-epochs{self.epochs}" if self.epochs != PAPER_EPOCHS else ""
        precision = f"-{self.precision}" if self.precision != "float32" else ""
        device = f"-{self.device}" if self.device != "cpu" else ""
        return (
            f"{self.robot}-{self.task}-{self.model}{supervised}{epochs}{precision}{device}"
            f"-size{self.size}-sigma{self.sigma:g}-seed{self.seed}.json"
        )


def run_cell(cell: Cell) -> dict[str, Any]:
    """Train and measure.

    :param cell: what
    :return: JSON-able: the cell's own fields, and ``validation_rmse``, ``test_rmse`` (over all
        joints, and over those that move the hand), ``per_joint``, ``task_space_mm``,
        ``latency_ms``, ``batch_us`` and ``training_s``
    """
    from saver_envs.modelling.arms import arm_named
    from saver_envs.modelling.datasets import samples_of, twin_data_set
    from saver_envs.modelling.models import Training, new_model

    data = twin_data_set(cell.robot, cell.data_seed)
    inputs, outputs = samples_of(data.train.first(cell.size * SAMPLES_A_SIZE), cell.task)
    test_inputs, test_outputs = samples_of(data.test, cell.task)
    model = new_model(cell.model, cell.robot, cell.task)
    training = Training(
        epochs=cell.epochs,
        sigma=cell.sigma,
        supervised_weight=cell.supervised_weight,
        precision=cell.precision,
        device=cell.device,
        seed=cell.seed,
    )
    wall, cpu = time.perf_counter(), time.process_time()
    history = model.fit(inputs, outputs, training)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    # A model that asks for the present joints gets those of the sample before.
    before = np.concatenate([test_outputs[:1], test_outputs[:-1]])
    present = before if model.needs_present else None
    predicted = model.predict(test_inputs, present)
    per_joint = np.sqrt(np.square(predicted - test_outputs).mean(axis=0))
    moving = [joint for joint in range(model.arm.dof) if joint not in model.arm.idle_joints]
    result: dict[str, Any] = {
        **asdict(cell),
        "validation_rmse": rms(history.per_output),
        "validation_rmse_moving": rms([history.per_output[joint] for joint in moving]),
        "test_rmse": rms(per_joint.tolist()),
        "test_rmse_moving": rms(per_joint[moving].tolist()),
        "per_joint": per_joint.tolist(),
        "best_epoch": history.best_epoch,
        "training_s": {"wall": wall, "cpu": cpu},
        **prediction_speed(
            lambda rows: model.predict(test_inputs[rows], _of(present, rows)), len(before)
        ),
    }
    if cell.task == "ik":
        result["task_space_mm"] = _task_space(arm_named(cell.robot), test_inputs, predicted)
    return result


def rms(values: list[float]) -> float:
    """Root mean square of channels' root mean squares."""
    return float(np.sqrt(np.mean(np.square(values))))


def _of(values: FloatArray | None, rows: slice) -> FloatArray | None:
    return None if values is None else values[rows]


def _task_space(arm: Any, targets: FloatArray, joints: FloatArray) -> dict[str, dict[str, float]]:
    """How far the hand is from its target, before and behind Newton steps."""
    from saver_envs.modelling.accuracy import distances
    from saver_envs.modelling.solvers import newton

    few = slice(0, len(targets), max(1, len(targets) // _TASK_SPACE_ROWS))
    targets, joints = targets[few], joints[few]
    refined = newton(arm, targets, joints, REFINED, arm.chain)
    return {
        name: distances(np.linalg.norm(arm.chain.position(one) - targets, axis=1))
        for name, one in (("raw", joints), ("refined", refined))
    }


def prediction_speed(predict: Callable[[slice], object], rows: int) -> dict[str, float]:
    """Time of one prediction, and of one among many; medians over calls.

    :param predict: what is timed, of some of the rows
    :param rows: that there are
    :return: ``latency_ms``, and ``batch_us`` for each of up to 4,096
    """
    one = [timed(predict, slice(row % rows, row % rows + 1)) for row in range(_LATENCY_CALLS)]
    many = min(_LARGE_BATCH, rows)
    batch = [timed(predict, slice(0, many)) for _ in range(7)]
    return {"latency_ms": median(one) * 1e3, "batch_us": median(batch) / many * 1e6}


def timed(predict: Callable[[slice], object], rows: slice) -> float:
    """Duration of one call (s)."""
    began = time.perf_counter()
    predict(rows)
    return time.perf_counter() - began
