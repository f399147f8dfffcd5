"""The cells of chapter 7's grid: train and measure them, and read their results."""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from itertools import product
from pathlib import Path
from statistics import median
from typing import Any, Final

import numpy as np

from reproduction.command_parts import shares
from saver_advisors.benchmark.machine import timed
from saver_advisors.reporting.provenance import provenance, write_json_atomic
from saver_advisors.training.threads import one_thread_of_algebra
from saver_envs.modelling.accuracy import distances
from saver_envs.modelling.arms import Task, arm_named
from saver_envs.modelling.chain import FloatArray
from saver_envs.modelling.datasets import samples_of, twin_data_set
from saver_envs.modelling.models import ADVERSARIAL, InverseModel, Training, new_model
from saver_envs.modelling.networks import DEVICES, PRECISIONS, Device, Precision
from saver_envs.modelling.solvers import newton

SAMPLES_A_SIZE: Final = 10_000
"""Size k stands for the first k x 10,000 consecutive samples."""

SIZES: Final = (1, 2, 3, 4, 5, 6)
SIGMAS: Final = (0.0, 0.2, 0.4, 0.6)

PAPER_EPOCHS: Final = 100
"""Epochs of the paper's training runs."""

REFINED: Final = 2
"""Newton steps after a network's prediction, for the refined figures."""

_TASK_SPACE_ROWS: Final = 6000
_LARGE_BATCH: Final = 4096
_LATENCY_CALLS: Final = 300
#: Models whose networks are trained in the requested precision.
_IN_EITHER_PRECISION = frozenset({"mlp", "cgan", "lsgan", "bigan", "dualgan", "conditional"})
#: Models that are trained on the requested device; the others have no networks.
_ON_EITHER_DEVICE = _IN_EITHER_PRECISION | {"flow"}
#: Keys of a complete result besides the cell's own fields.
_COMPLETE = frozenset({"test_rmse", "validation_rmse", "latency_ms", "provenance"})


@dataclass(frozen=True)
class GridCell:
    """Everything that the result of a training run depends on.

    :param robot: name of the arm.
    :param task: "ik" or "id".
    :param model: name of the model.
    :param size: number of samples, in tens of thousands.
    :param sigma: standard deviation of the fake inputs; 0 for models that are not adversarial.
    :param seed: seed of split, weights and noise.
    :param epochs: epochs of training.
    :param supervised_weight: weight of the squared error in an adversarial model's loss.
    :param precision: precision of the matrix products during training.
    :param data_seed: seed of the data set.
    :param device: device that trains.
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
        """Name of the cell's JSON file."""
        supervised = f"-supervised{self.supervised_weight:g}" if self.supervised_weight else ""
        epochs = f"-epochs{self.epochs}" if self.epochs != PAPER_EPOCHS else ""
        precision = f"-{self.precision}" if self.precision != "float32" else ""
        device = f"-{self.device}" if self.device != "cpu" else ""
        return (
            f"{self.robot}-{self.task}-{self.model}{supervised}{epochs}{precision}{device}"
            f"-size{self.size}-sigma{self.sigma:g}-seed{self.seed}.json"
        )


def run_cell(cell: GridCell) -> dict[str, Any]:
    """Train a cell's model and measure it.

    :param cell: the cell.
    :return: JSON-able: the cell's own fields, and ``validation_rmse``, ``test_rmse`` (over all
        joints, and over those that move the hand), ``per_joint``, ``task_space_mm``,
        ``latency_ms``, ``batch_us`` and ``training_s``.
    """
    data = twin_data_set(cell.robot, cell.data_seed)
    inputs, outputs = samples_of(data.train.first(cell.size * SAMPLES_A_SIZE), cell.task)
    test_inputs, test_outputs = samples_of(data.test, cell.task)
    model = new_model(cell.model, cell.robot, cell.task)
    names = ("epochs", "sigma", "supervised_weight", "precision", "device", "seed")
    training = Training(**{name: getattr(cell, name) for name in names})
    wall, cpu = time.perf_counter(), time.process_time()
    history = model.fit(inputs, outputs, training)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    # A model that needs the present joints receives those of the previous sample.
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
        **prediction_speed(model, test_inputs, present),
    }
    if cell.task == "ik":
        result["task_space_mm"] = _task_space(arm_named(cell.robot), test_inputs, predicted)
    return result


def rms(values: list[float]) -> float:
    """Combine the root mean squares of channels into one."""
    return float(np.sqrt(np.mean(np.square(values))))


def _task_space(arm: Any, targets: FloatArray, joints: FloatArray) -> dict[str, dict[str, float]]:
    """Measure the distance from hand to target (mm), before and after Newton steps."""
    few = slice(0, len(targets), max(1, len(targets) // _TASK_SPACE_ROWS))
    targets, joints = targets[few], joints[few]
    refined = newton(arm, targets, joints, REFINED, arm.chain)
    return {
        name: distances(np.linalg.norm(arm.chain.position(one) - targets, axis=1))
        for name, one in (("raw", joints), ("refined", refined))
    }


def prediction_speed(
    model: InverseModel, inputs: FloatArray, present: FloatArray | None
) -> dict[str, float]:
    """Time single predictions and batches; figures are medians over calls.

    :param model: the model.
    :param inputs: (n, inputs), at least one row.
    :param present: (n, joints) present joints in rad, if the model needs them.
    :return: ``latency_ms`` of one prediction, and ``batch_us`` per prediction of up to 4,096.
    """
    rows, many = len(inputs), min(_LARGE_BATCH, len(inputs))

    def duration(first: int, count: int) -> float:
        chosen = slice(first, first + count)
        now = None if present is None else present[chosen]
        return timed(lambda: model.predict(inputs[chosen], now))

    one = [duration(call % rows, 1) for call in range(_LATENCY_CALLS)]
    batch = [duration(0, many) for _ in range(7)]
    return {"latency_ms": median(one) * 1e3, "batch_us": median(batch) / many * 1e6}


def cells_of(
    robot: str,
    task: Task,
    models: Sequence[str],
    sizes: Sequence[int],
    sigmas: Sequence[float],
    seeds: Sequence[int],
    epochs: int,
    supervised_weight: float = 0.0,
    precision: Precision = "float32",
    device: Device = "cpu",
) -> list[GridCell]:
    """List the cells of a grid, cheapest sizes first.

    Models without fake inputs have one cell per size and seed, models without random weights one
    per size.

    :param robot: name of the arm.
    :param task: "ik" or "id".
    :param models: names of the models.
    :param sizes: numbers of samples, in tens of thousands.
    :param sigmas: standard deviations of the fake inputs of adversarial models.
    :param seeds: seeds of the training.
    :param epochs: epochs of training.
    :param supervised_weight: weight of the squared error in the adversarial losses.
    :param precision: precision of the networks' matrix products during training.
    :param device: device that trains the networks.
    :return: the cells.
    """
    cells = []
    for size, model in product(sizes, models):
        options: dict[str, Any] = {"epochs": epochs}
        if model in ADVERSARIAL:
            options["supervised_weight"] = supervised_weight
        if model in _IN_EITHER_PRECISION:
            options["precision"] = precision
        if model in _ON_EITHER_DEVICE:
            options["device"] = device
        for sigma in sigmas if model in ADVERSARIAL else (0.0,):
            for seed in seeds if model != "analytic" else seeds[:1]:
                cells.append(GridCell(robot, task, model, size, sigma, seed, **options))
    return cells


def read_result(folder: Path, cell: GridCell) -> dict[str, Any] | None:
    """Read the result of a cell.

    :param folder: folder of the results.
    :param cell: the cell.
    :return: its result; None if there is none, or if it is incomplete or has other settings.
    """
    try:
        content = json.loads((folder / cell.file_name).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if not isinstance(content, dict) or not content.keys() >= _COMPLETE:
        return None
    # A file from before a setting existed has its default.
    same = all(
        content.get(field.name, field.default) == getattr(cell, field.name)
        for field in fields(cell)
    )
    return content if same else None


def as_known(cell: GridCell, folder: Path) -> GridCell:
    """Return the cell on the hardware that it has a result of.

    :param cell: the cell.
    :param folder: folder of the results.
    :return: the cell itself if it has a result or if no other device and precision have one.
    """
    others = (
        replace(cell, device=device, precision=precision)
        for device, precision in product(DEVICES, PRECISIONS)
    )
    return next((one for one in (cell, *others) if read_result(folder, one) is not None), cell)


def run_grid(cells: Sequence[GridCell], folder: Path, processes: int) -> list[dict[str, Any]]:
    """Train the cells that have no result yet, and write each result once it is known.

    :param cells: the cells.
    :param folder: folder of the results, one JSON file per cell.
    :param processes: number of cells that are trained at once, one core each.
    :return: the new results.
    """
    folder.mkdir(parents=True, exist_ok=True)
    left = [cell for cell in cells if read_result(folder, cell) is None]
    with shares(processes) as share:
        return share("cells", partial(_run, folder=folder), left)


@one_thread_of_algebra()
def _run(cell: GridCell, folder: Path) -> dict[str, Any]:
    result = {**run_cell(cell), "provenance": provenance()}
    write_json_atomic(folder / cell.file_name, result)
    return result


def results_of(cells: Iterable[GridCell], folder: Path) -> list[dict[str, Any]]:
    """Read the results of cells.

    :param cells: the cells.
    :param folder: folder of the results.
    :return: the results that exist, in the order of the cells.
    """
    found = (read_result(folder, cell) for cell in cells)
    return [result for result in found if result is not None]
