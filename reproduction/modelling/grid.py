"""The grid of chapter 7: which cells there are, which are done, and doing the rest."""

from __future__ import annotations

import json
import multiprocessing
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from reproduction.modelling.cells import (
    DEVICES,
    PRECISIONS,
    Cell,
    Device,
    Precision,
    Task,
    run_cell,
)
from saver_advisors.reporting.provenance import provenance, write_json_atomic

#: Models whose networks are trained in the precision that is asked for.
_IN_EITHER_PRECISION = frozenset({"mlp", "cgan", "lsgan", "bigan", "dualgan", "conditional"})
#: Models that are trained on the device that is asked for; the others have no networks.
_ON_EITHER_DEVICE = _IN_EITHER_PRECISION | {"flow"}
#: A result has these besides the cell's own fields; one that lacks them is made again.
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
) -> list[Cell]:
    """The cells of a grid, cheapest sizes first.

    Models without fake inputs have one cell a size and seed, those without weights to draw one a
    size.

    :param robot: the arm's name
    :param task: "ik" or "id"
    :param models: their names
    :param sizes: tens of thousands of samples
    :param sigmas: of the adversarial models
    :param seeds: of the training
    :param epochs: of the training
    :param supervised_weight: of the adversarial models
    :param precision: of the networks' products while training
    :param device: that trains the networks
    """
    from saver_envs.modelling.models import ADVERSARIAL

    cells = []
    for size in sizes:
        for model in models:
            adversarial = model in ADVERSARIAL
            for sigma in sigmas if adversarial else (0.0,):
                for seed in seeds if model != "analytic" else seeds[:1]:
                    weight = supervised_weight if adversarial else 0.0
                    cell = Cell(robot, task, model, size, sigma, seed, epochs, weight)
                    if model in _IN_EITHER_PRECISION:
                        cell = replace(cell, precision=precision)
                    if model in _ON_EITHER_DEVICE:
                        cell = replace(cell, device=device)
                    cells.append(cell)
    return cells


def read_result(folder: Path, cell: Cell) -> dict[str, Any] | None:
    """An earlier result of a cell; None where there is none, or one that is cut short or of other
    settings.

    :param folder: of the results
    :param cell: which
    """
    try:
        content = json.loads((folder / cell.file_name).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if not isinstance(content, dict) or not content.keys() >= _COMPLETE:
        return None
    # A file from before a setting was there has its default.
    same = all(
        content.get(field.name, field.default) == getattr(cell, field.name)
        for field in fields(cell)
    )
    return content if same else None


def as_known(cell: Cell, folder: Path) -> Cell:
    """The cell on the hardware that it has a result of, its own first; itself where it has none.

    :param cell: what
    :param folder: of the results
    """
    others = (
        replace(cell, device=device, precision=precision)
        for device in DEVICES
        for precision in PRECISIONS
    )
    return next(
        (one for one in (cell, *others) if read_result(folder, one) is not None),
        cell,
    )


def run_grid(cells: Sequence[Cell], folder: Path, processes: int) -> Iterator[dict[str, Any]]:
    """Run the cells that have no result yet, and yield each result as it is written.

    :param cells: which
    :param folder: where results are and will be, a JSON file a cell
    :param processes: cells that are trained at once, one core each
    """
    folder.mkdir(parents=True, exist_ok=True)
    left = [cell for cell in cells if read_result(folder, cell) is None]
    if processes == 1 or len(left) < 2:
        for cell in left:
            yield _run(cell, folder)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(processes, len(left)), mp_context=context) as pool:
        tasks = [pool.submit(_run, cell, folder) for cell in left]
        try:
            for task in as_completed(tasks):
                yield task.result()
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _run(cell: Cell, folder: Path) -> dict[str, Any]:
    from saver_advisors.training.threads import one_thread_of_algebra

    with one_thread_of_algebra():
        result = {**run_cell(cell), "provenance": provenance()}
    write_json_atomic(folder / cell.file_name, result)
    return result


def results_of(cells: Iterable[Cell], folder: Path) -> list[dict[str, Any]]:
    """The results that there are, in the order of the cells.

    :param cells: which
    :param folder: of the results
    """
    found = (read_result(folder, cell) for cell in cells)
    return [result for result in found if result is not None]
