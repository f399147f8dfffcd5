"""How long the networks of chapter 7 take to train, and where the time goes.

A run is the paper's: all samples, 100 epochs, on one core. Where its time goes is read off torch's
own profiler over an epoch of 10,000 samples, apart from the run, which a profiler would slow down.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from typing import Any, Final

from reproduction.modelling.cells import (
    PAPER_EPOCHS,
    SAMPLES_A_SIZE,
    FloatArray,
    Precision,
    Task,
)
from saver_advisors.cli.measured import hand_over, measured_or_read

EXAMPLES: Final = """\
examples:
  python -m reproduction modelling --json modelling-time.json
  python -m reproduction modelling --tasks ik --models cgan --precision bfloat16"""

NETWORKS: Final = ("mlp", "cgan", "lsgan", "bigan", "dualgan")
TASKS: Final[tuple[Task, ...]] = ("ik", "id")
PARTS: Final = {
    "products of matrices": ("aten::addmm", "aten::mm"),
    "activations": ("aten::leaky_relu", "aten::leaky_relu_backward"),
    "optimiser": ("aten::_fused_adam_",),
}
"""Operators of torch by what they are for; what is in none of them is *other operators*, and what
is in no operator *Python*."""

_SAMPLES: Final = 60_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    from reproduction.modelling.arguments import ROBOTS, add_precision
    from saver_advisors.cli.arguments import add_page, at_least

    parser.add_argument("--robot", choices=ROBOTS, default="mico", help="(default: mico)")
    parser.add_argument(
        "--tasks", nargs="+", choices=TASKS, default=["ik"], metavar="TASK", help="(default: ik)"
    )
    parser.add_argument(
        "--models",
        nargs="+",
        choices=NETWORKS,
        default=["mlp", "cgan"],
        metavar="NAME",
        help="(default: mlp cgan)",
    )
    parser.add_argument(
        "--samples", type=at_least(100), default=_SAMPLES, metavar="N", help="(default: 60000)"
    )
    parser.add_argument(
        "--epochs",
        type=at_least(1),
        default=PAPER_EPOCHS,
        metavar="N",
        help=f"(default: {PAPER_EPOCHS})",
    )
    add_precision(parser)
    add_page(parser)


def run(args: argparse.Namespace) -> int:
    """Measure, show, and write where asked for.

    :param args: see :func:`add_arguments`
    :return: exit status
    """
    from saver_advisors.training.threads import one_thread_of_algebra

    with one_thread_of_algebra():
        figures = measured_or_read(args, "modelling-time", lambda: measure(args))
    hand_over(render(figures), figures, args.json, args.table)
    return 0


def measure(args: argparse.Namespace) -> dict[str, Any]:
    """Train every model for every task.

    :param args: see :func:`add_arguments`
    :return: JSON-able; ``rows`` has one of every task and model
    """
    from saver_advisors.cli.model_data import prepare_data

    prepare_data(args.robot)
    rows = [_row(args, task, model) for task in args.tasks for model in args.models]
    return {
        "title": "How long the arms' models take to train",
        "kind": "modelling-time",
        "robot": args.robot,
        "precision": args.precision,
        "rows": rows,
    }


def _row(args: argparse.Namespace, task: Task, name: str) -> dict[str, Any]:
    """A whole run, and where a short one's time goes."""
    from saver_advisors.reporting.provenance import load_averages
    from saver_envs.modelling.datasets import samples_of, twin_data_set
    from saver_envs.modelling.models import Training, new_model

    recording = twin_data_set(args.robot).train
    samples = samples_of(recording.first(min(args.samples, len(recording))), task)
    training = Training(epochs=args.epochs, precision=args.precision)
    wall, cpu = time.perf_counter(), time.process_time()
    new_model(name, args.robot, task).fit(*samples, training)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    loads = load_averages()
    return {
        "task": task,
        "model": name,
        "samples": len(samples[0]),
        "epochs": args.epochs,
        "wall_minutes": wall / 60,
        "cpu_minutes": cpu / 60,
        "load_average": loads[0] if loads else None,
        "shares": _shares(args.robot, task, name, args.precision, samples),
    }


def _shares(
    robot: str,
    task: Task,
    name: str,
    precision: Precision,
    samples: tuple[FloatArray, FloatArray],
) -> dict[str, float]:
    """Shares of the process's time by part, over an epoch of few samples."""
    from torch.profiler import ProfilerActivity, profile

    from saver_envs.modelling.models import Training, new_model

    inputs, outputs = (one[:SAMPLES_A_SIZE] for one in samples)
    model = new_model(name, robot, task)
    training = Training(epochs=1, precision=precision)
    model.fit(inputs, outputs, training)  # the first run pays for what is set up once
    model = new_model(name, robot, task)
    began = time.perf_counter()
    with profile(activities=[ProfilerActivity.CPU]) as profiler:
        model.fit(inputs, outputs, training)
        whole = time.perf_counter() - began
    parts: dict[str, float] = defaultdict(float)
    for event in profiler.key_averages():
        if event.key.startswith(("aten::", "autograd::")):
            parts[_part(event.key)] += event.self_cpu_time_total * 1e-6
    parts["Python"] = max(0.0, whole - sum(parts.values()))
    total = sum(parts.values())
    return {name: parts[name] / total for name in (*PARTS, "other operators", "Python")}


def _part(operator: str) -> str:
    return next((name for name, those in PARTS.items() if operator in those), "other operators")


def render(figures: dict[str, Any]) -> str:
    """The figures as a page of Markdown.

    :param figures: what was measured, or its JSON file's content
    """
    from saver_advisors.reporting.tables import markdown
    from saver_envs.modelling.arms import TASK_NAMES

    rows = figures["rows"]
    shares = list(rows[0]["shares"])
    cells = [
        [
            TASK_NAMES[one["task"]],
            one["model"],
            f"{one['samples']:,}",
            str(one["epochs"]),
            f"{one['wall_minutes']:.1f}",
            f"{one['cpu_minutes']:.1f}",
            "-" if one["load_average"] is None else f"{one['load_average']:.1f}",
            *(f"{one['shares'][name]:.0%}" for name in shares),
        ]
        for one in rows
    ]
    columns = ["task", "model", "samples", "epochs", "minutes", "of CPU", "load", *shares]
    machine = figures["provenance"]["machine"]
    return (
        f"# {figures['title']}\n\n"
        f"Training runs of the paper's length on one core ({machine['cpu']}), {figures['robot']}, "
        f"hidden products in {figures['precision']}; *load* is the system's when they ended: where "
        "it is above the machine's cores, minutes say little. Then the shares of the parts of "
        "training; *Python* is what is in no operator of torch, the profiler's own part included."
        f"\n\n{markdown(columns, cells)}"
    )
