"""Inverse kinematics and dynamics of chapter 7: the networks and their peers, beside the tables.

Every cell (model, data size, sigma, seed) is trained once and kept as a JSON file: a run that was
killed goes on where it was. `ik.py` and `id.py` bind the task.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from saver_advisors.benchmarks.measured import hand_over, measured_or_read
from saver_advisors.benchmarks.modelling_cells import PAPER_EPOCHS, SIGMAS, SIZES, Task

ROBOTS: Final = ("mico", "fetch")
MODELS: Final[Mapping[Task, tuple[str, ...]]] = {
    "ik": ("mlp", "cgan", "lsgan", "bigan", "dualgan", "analytic", "conditional", "flow"),
    "id": ("mlp", "cgan", "lsgan", "bigan", "dualgan", "analytic", "identified"),
}
PRECISIONS: Final = ("float32", "bfloat16")
RESULTS: Final = Path("runs/modelling")


def examples(task: Task) -> str:
    """The examples of a task's command.

    :param task: "ik" or "id"
    """
    return f"""\
examples:
  saver benchmark {task} --robot mico --table mico-{task}.md --json mico-{task}.json
  saver benchmark {task} --robot mico --sizes 1 --sigmas 0 --models mlp cgan --epochs 10
  saver benchmark {task} --robot fetch --sizes 1 6 --sigmas 0 0.2 --seeds 0 1 --processes 2"""


def declare(parser: argparse.ArgumentParser, task: Task) -> None:
    """Declare the arguments.

    :param parser: the command's
    :param task: "ik" or "id"
    """
    from saver_advisors.cli.arguments import add_page, at_least

    models = MODELS[task]

    parser.add_argument("--robot", choices=ROBOTS, default="mico", help="which arm (default: mico)")
    parser.add_argument(
        "--models",
        nargs="+",
        choices=models,
        default=list(models),
        metavar="NAME",
        help=f"which models (default: {' '.join(models)})",
    )
    parser.add_argument(
        "--sizes",
        nargs="+",
        type=int,
        choices=SIZES,
        default=list(SIZES),
        metavar="K",
        help="the first K x 10,000 samples (default: 1 2 3 4 5 6)",
    )
    parser.add_argument(
        "--sigmas",
        nargs="+",
        type=float,
        choices=SIGMAS,
        default=list(SIGMAS),
        metavar="S",
        help="spread of the fake inputs, adversarial models alone (default: 0 0.2 0.4 0.6)",
    )
    parser.add_argument(
        "--seeds",
        nargs="+",
        type=at_least(0),
        default=[0],
        metavar="N",
        help="of split, weights and noise (default: 0)",
    )
    parser.add_argument(
        "--epochs",
        type=at_least(1),
        default=PAPER_EPOCHS,
        metavar="N",
        help=f"(default: {PAPER_EPOCHS}, the paper's)",
    )
    add_precision(parser)
    parser.add_argument(
        "--or-precision",
        nargs="+",
        choices=PRECISIONS,
        default=[],
        metavar="NAME",
        help="let results count that were trained in these: for a grid that went from one "
        "processor to another",
    )
    parser.add_argument(
        "--supervised-weight",
        nargs="+",
        type=_weight,
        default=[0.0],
        metavar="W",
        help="of a squared error in the adversarial losses, which the paper's equations lack; "
        "several are shown apart (default: 0)",
    )
    parser.add_argument(
        "--processes",
        type=at_least(1),
        default=1,
        metavar="N",
        help="cells trained at once, one core each (default: 1)",
    )
    parser.add_argument(
        "--results",
        type=Path,
        default=RESULTS,
        metavar="DIR",
        help=f"where the cells' files are kept (default: {RESULTS})",
    )
    parser.add_argument(
        "--no-training",
        action="store_true",
        help="show the cells that there are, and train none",
    )
    add_page(parser)


def add_arms_and_models(
    parser: argparse.ArgumentParser, arms: Sequence[str], models: Sequence[str], purpose: str
) -> None:
    """Declare which arms, and which models are trained for them while measuring, and how.

    :param parser: a command's that measures models in use
    :param arms: that can be measured
    :param models: that can be trained
    :param purpose: of those, for the help
    """
    from saver_advisors.cli.arguments import at_least

    parser.add_argument(
        "--robots",
        nargs="+",
        choices=arms,
        default=list(arms),
        metavar="ARM",
        help=f"(default: {' '.join(arms)})",
    )
    parser.add_argument(
        "--models",
        nargs="*",
        choices=models,
        default=[],
        metavar="NAME",
        help=f"{purpose} (default: none)",
    )
    parser.add_argument(
        "--epochs",
        type=at_least(1),
        default=PAPER_EPOCHS,
        metavar="N",
        help=f"of those (default: {PAPER_EPOCHS})",
    )
    add_precision(parser)


def add_precision(parser: argparse.ArgumentParser) -> None:
    """Declare in what precision networks are trained.

    :param parser: a command's that trains inverse models
    """
    parser.add_argument(
        "--precision",
        choices=PRECISIONS,
        default="float32",
        metavar="NAME",
        help="of the products between hidden layers while training: float32, or bfloat16, which "
        "takes two thirds of the time where the processor has it, and very long where it has not "
        "(default: float32)",
    )


def _weight(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
    if not 0 <= value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text}: must be 0 or more")
    return value


def execute(args: argparse.Namespace, task: Task) -> int:
    """Train what is missing, show, and write where asked for.

    :param args: see :func:`declare`
    :param task: "ik" or "id"
    :return: exit status
    """
    from saver_advisors.benchmarks.modelling_table import render

    figures = measured_or_read(args, f"modelling-{task}", lambda: _measure(args, task), task)
    hand_over(render(figures), figures, args.json, args.table)
    return 0


def _measure(args: argparse.Namespace, task: Task) -> dict[str, Any]:
    from saver_advisors.benchmarks.modelling_claims import claims, little_data
    from saver_advisors.benchmarks.modelling_grid import (
        cells_of,
        in_known_precision,
        results_of,
        run_grid,
    )
    from saver_advisors.cli.errors import UsageError
    from saver_envs.modelling.arms import TASK_NAMES

    grid = args.robot, task, args.models, args.sizes, args.sigmas, args.seeds, args.epochs
    weighted = [cells_of(*grid, weight, args.precision) for weight in args.supervised_weight]
    wanted = dict.fromkeys(cell for part in weighted for cell in part)
    cells = [in_known_precision(cell, args.results, args.or_precision) for cell in wanted]
    if not args.no_training:
        prepare_data(args.robot)
        _train(cells, args.results, args.processes, run_grid)
    results = results_of(cells, args.results)
    if not results:
        raise UsageError(f"argument --results: {args.results} has none of the cells asked for")
    return {
        "title": f"{TASK_NAMES[task].capitalize()}, {args.robot}",
        "kind": f"modelling-{task}",
        "robot": args.robot,
        "task": task,
        "epochs": args.epochs,
        "cells": results,
        "claims": claims(args.robot, task, results),
        "little_data": little_data(task, results),
    }


def prepare_data(robot: str, seed: int = 0) -> None:
    """Make the arm's data set if it is not there, with a progress bar.

    :param robot: the arm's name
    :param seed: of the data set
    """
    from tqdm import tqdm

    from saver_envs.modelling.datasets import simulated_steps, twin_data_set

    with tqdm(
        total=simulated_steps(robot), desc=f"{robot}: data", unit="step", delay=2.0, leave=False
    ) as bar:

        def progress(steps: int) -> None:
            bar.update(steps)

        twin_data_set(robot, seed, progress=progress)


def _train(cells: Sequence[Any], folder: Path, processes: int, run_grid: Any) -> None:
    from tqdm import tqdm

    from saver_advisors.benchmarks.modelling_grid import read_result

    done = sum(read_result(folder, cell) is not None for cell in cells)
    with tqdm(total=len(cells), initial=done, unit="cell", dynamic_ncols=True) as progress:
        for result in run_grid(cells, folder, processes):
            progress.set_description(f"{result['model']}, size {result['size']}")
            progress.update()
