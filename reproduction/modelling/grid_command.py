"""Inverse kinematics and dynamics of chapter 7: the networks and their peers, beside the tables.

Every cell (model, data size, sigma, seed) is trained once and kept as a JSON file: a run that was
killed goes on where it was. `ik.py` and `id.py` bind the task.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from reproduction.modelling.arguments import check_device
from reproduction.modelling.cells import SAMPLES_A_SIZE, Task
from saver_advisors.cli.measured import hand_over, measured_or_read
from saver_advisors.cli.model_data import prepare_data


def examples(task: Task) -> str:
    """The examples of a task's command.

    :param task: "ik" or "id"
    """
    return f"""\
examples:
  saver benchmark {task} --robot mico --table mico-{task}.md --json mico-{task}.json
  saver benchmark {task} --robot mico --sizes 1 --sigmas 0 --models mlp cgan --epochs 10
  saver benchmark {task} --robot fetch --sizes 1 6 --sigmas 0 0.2 --seeds 0 1 --processes 2"""


def execute(args: argparse.Namespace, task: Task) -> int:
    """Train what is missing, show, and write where asked for.

    :param args: see ``arguments.declare``
    :param task: "ik" or "id"
    :return: exit status
    """
    from reproduction.modelling.table import render

    figures = measured_or_read(args, f"modelling-{task}", lambda: _measure(args, task))
    hand_over(render(figures), figures, args.json, args.table)
    return 0


def _measure(args: argparse.Namespace, task: Task) -> dict[str, Any]:
    from reproduction.modelling.claims import claims, little_data
    from reproduction.modelling.grid import (
        as_known,
        cells_of,
        results_of,
        run_grid,
    )
    from saver_advisors.reporting.errors import UsageError

    grid = args.robot, task, args.models, args.sizes, args.sigmas, args.seeds, args.epochs
    how = args.precision, args.device
    weighted = [cells_of(*grid, weight, *how) for weight in args.supervised_weight]
    cells = list(dict.fromkeys(cell for part in weighted for cell in part))
    if args.any_hardware:
        cells = [as_known(cell, args.results) for cell in cells]
    if not args.no_training:
        check_device(args.device)
        prepare_data(args.robot)
        _train(cells, args.results, args.processes, run_grid)
    results = results_of(cells, args.results)
    if not results:
        raise UsageError(f"argument --results: {args.results} has none of the cells asked for")
    return {
        "title": _title(task, args.robot, args.sizes),
        "kind": f"modelling-{task}",
        "robot": args.robot,
        "task": task,
        "epochs": args.epochs,
        "cells": results,
        "claims": claims(args.robot, task, results),
        "little_data": little_data(task, results),
    }


def _title(task: Task, robot: str, sizes: Sequence[int]) -> str:
    """What the page is of; a grid of one size says which, for there is one of all sizes beside."""
    from saver_envs.modelling.arms import TASK_NAMES

    title = f"{TASK_NAMES[task].capitalize()}, {robot}"
    return f"{title}, {sizes[0] * SAMPLES_A_SIZE:,} samples" if len(sizes) == 1 else title


def _train(cells: Sequence[Any], folder: Path, processes: int, run_grid: Any) -> None:
    from tqdm import tqdm

    from reproduction.modelling.grid import read_result

    done = sum(read_result(folder, cell) is not None for cell in cells)
    with tqdm(total=len(cells), initial=done, unit="cell", dynamic_ncols=True) as progress:
        for result in run_grid(cells, folder, processes):
            progress.set_description(f"{result['model']}, size {result['size']}")
            progress.update()
