"""List the cells of chapter 7's grid, read their results, and train the cells without results."""

from __future__ import annotations

import json
import multiprocessing
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import fields, replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

from reproduction.modelling.grid_cells import DEVICES, PRECISIONS, GridCell, run_cell
from saver_advisors.reporting.provenance import provenance, write_json_atomic
from saver_advisors.training.threads import one_thread_of_algebra

if TYPE_CHECKING:
    from saver_envs.modelling.arms import Task
    from saver_envs.modelling.networks import Device, Precision

#: Models whose networks are trained in the requested precision.
_IN_EITHER_PRECISION = frozenset({"mlp", "cgan", "lsgan", "bigan", "dualgan", "conditional"})
#: Models that are trained on the requested device; the others have no networks.
_ON_EITHER_DEVICE = _IN_EITHER_PRECISION | {"flow"}
#: Keys of a complete result besides the cell's own fields.
_COMPLETE = frozenset({"test_rmse", "validation_rmse", "latency_ms", "provenance"})


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
    from saver_envs.modelling.models import ADVERSARIAL

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


def run_grid(cells: Sequence[GridCell], folder: Path, processes: int) -> Iterator[dict[str, Any]]:
    """Train the cells that have no result yet, and yield each result once it is written.

    :param cells: the cells.
    :param folder: folder of the results, one JSON file per cell.
    :param processes: number of cells that are trained at once, one core each.
    """
    folder.mkdir(parents=True, exist_ok=True)
    left = [cell for cell in cells if read_result(folder, cell) is None]
    if processes == 1 or len(left) < 2:
        yield from (_run(cell, folder) for cell in left)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(processes, len(left)), mp_context=context) as pool:
        tasks = [pool.submit(_run, cell, folder) for cell in left]
        try:
            for task in as_completed(tasks):
                yield task.result()
        finally:
            pool.shutdown(cancel_futures=True)


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
