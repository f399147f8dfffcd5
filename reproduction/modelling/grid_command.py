"""Train the models of chapter 7 for inverse kinematics or dynamics, and compare with its tables.

Each cell (model, data size, sigma, seed) is trained once and kept as a JSON file, so that an
interrupted grid can be continued. The commands ``ik`` and ``id`` differ in the task only.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from reproduction.command_parts import add_choices
from reproduction.modelling.grid import (
    SAMPLES_A_SIZE,
    SIGMAS,
    SIZES,
    as_known,
    cells_of,
    results_of,
    run_grid,
)
from reproduction.modelling.grid_page import render
from reproduction.modelling.model_arguments import ROBOTS, add_training, training_of
from reproduction.modelling.paper_claims import claims, little_data
from saver_advisors.cli.arguments import (
    add,
    add_count,
    add_flag,
    add_page,
    add_path,
    add_several,
    at_least,
)
from saver_advisors.cli.measured import measure_and_render
from saver_advisors.cli.model import prepare_data
from saver_advisors.reporting.errors import UsageError, user_mistakes
from saver_envs.modelling.arms import TASK_NAMES, Task
from saver_envs.modelling.models import Training

MODELS: Final[Mapping[Task, tuple[str, ...]]] = {
    "ik": ("mlp", "cgan", "lsgan", "bigan", "dualgan", "analytic", "conditional", "flow"),
    "id": ("mlp", "cgan", "lsgan", "bigan", "dualgan", "analytic", "identified"),
}
RESULTS: Final = Path("runs/modelling")
EXAMPLES: Final = """\
examples:
  python -m reproduction ik --robot mico --table mico-ik.md --json mico-ik.json
  python -m reproduction id --robot mico --sizes 1 --sigmas 0 --models mlp cgan --epochs 10
  python -m reproduction ik --robot fetch --sizes 1 6 --sigmas 0 0.2 --seeds 0 1 --processes 2"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments; the command's name is the task."""
    task: Task = "ik" if parser.prog.split()[-1] == "ik" else "id"
    parser.set_defaults(task=task)
    add(parser, "--robot", "arm", "mico", choices=ROBOTS)
    add_choices(parser, "--models", MODELS[task], "models")
    add_choices(parser, "--sizes", SIZES, "the first N x 10,000 samples")
    text = "standard deviations of the fake inputs of adversarial models"
    add_choices(parser, "--sigmas", SIGMAS, text)
    add_several(parser, "--seeds", at_least(0), [0], "seeds of split, weights and noise")
    text = (
        "weights of a squared error in the adversarial losses, which the paper's equations do not "
        "have"
    )
    add_several(parser, "--supervised-weight", float, [0.0], text, "W")
    add_training(parser)
    text = "number of cells trained at once, one core each; with --device cuda they share the GPU"
    add_count(parser, "--processes", 1, text)
    text = f"folder of the cells' files (default: {RESULTS})"
    add_path(parser, "--results", text, metavar="DIR", default=RESULTS)
    text = "accept results of any device and precision, for a grid that moves between machines"
    add_flag(parser, "--any-hardware", text)
    add_flag(parser, "--no-training", "show only the cells that have results")
    add_page(parser)


def run(args: argparse.Namespace) -> int:
    """Train the missing cells, print the page, and write the requested files.

    :param args: see :func:`add_arguments`.
    :return: exit status.
    :raises UsageError: if no cell has a result, or if there is no GPU and ``--device`` names one.
    """
    return measure_and_render(args, f"modelling-{args.task}", lambda: _measure(args), render)


def _measure(args: argparse.Namespace) -> dict[str, Any]:
    grid = args.robot, args.task, args.models, args.sizes, args.sigmas, args.seeds, args.epochs
    how = args.precision, args.device
    weighted = [cells_of(*grid, weight, *how) for weight in args.supervised_weight]
    cells = list(dict.fromkeys(cell for part in weighted for cell in part))
    if args.any_hardware:
        cells = [as_known(cell, args.results) for cell in cells]
    if not args.no_training:
        training_of(args)
        with user_mistakes("argument --supervised-weight"):
            for weight in args.supervised_weight:
                Training(supervised_weight=weight)
        prepare_data(args.robot)
        run_grid(cells, args.results, args.processes)
    results = results_of(cells, args.results)
    if not results:
        raise UsageError(f"argument --results: {args.results} has none of the cells asked for")
    title = f"{TASK_NAMES[args.task].capitalize()}, {args.robot}"
    if len(args.sizes) == 1:
        title += f", {args.sizes[0] * SAMPLES_A_SIZE:,} samples"
    return {
        "title": title,
        "kind": f"modelling-{args.task}",
        "robot": args.robot,
        "task": args.task,
        "epochs": args.epochs,
        "cells": results,
        "claims": claims(args.robot, args.task, results),
        "little_data": little_data(args.task, results),
    }
