"""Measure the training time of chapter 7's networks, in total and by part.

A run has the paper's length: all samples, 100 epochs, on one core. The parts come from torch's
profiler over an epoch of 10,000 samples, in a separate run because profiling slows training down.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Callable
from functools import partial
from itertools import product
from typing import Any, Final

from reproduction.command_parts import add_choices
from reproduction.modelling.grid import PAPER_EPOCHS, SAMPLES_A_SIZE
from reproduction.modelling.model_arguments import ROBOTS, add_precision
from reproduction.page_templates import page
from saver_advisors.cli.arguments import add, add_count, add_page
from saver_advisors.cli.measured import measure_and_render
from saver_advisors.cli.model import prepare_data
from saver_advisors.reporting.provenance import load_averages
from saver_advisors.reporting.tables import Column
from saver_envs.modelling.arms import TASK_NAMES, Task
from saver_envs.modelling.chain import FloatArray
from saver_envs.modelling.datasets import samples_of
from saver_envs.modelling.models import InverseModel, Training, new_model

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
"""Torch's operators by purpose. Time in none of them counts as *other operators*, and time outside
any operator as *Python*."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add(parser, "--robot", "arm", "mico", choices=ROBOTS)
    add_choices(parser, "--tasks", TASKS, "tasks", ["ik"])
    add_choices(parser, "--models", NETWORKS, "networks", ["mlp", "cgan"])
    add_count(parser, "--samples", 60_000, "samples of the data set", least=100)
    add_count(parser, "--epochs", PAPER_EPOCHS, "epochs of training")
    add_precision(parser)
    add_page(parser)


def run(args: argparse.Namespace) -> int:
    """Measure, print the page, and write the requested files.

    :param args: see :func:`add_arguments`.
    :return: exit status.
    """
    return measure_and_render(args, "modelling-time", lambda: measure(args), render)


def measure(args: argparse.Namespace) -> dict[str, Any]:
    """Train every model for every task.

    :param args: see :func:`add_arguments`.
    :return: JSON-able; ``rows`` has one row per task and model.
    """
    recording = prepare_data(args.robot).train
    training = Training(epochs=args.epochs, precision=args.precision)
    rows = []
    for task, name in product(args.tasks, args.models):
        samples = samples_of(recording.first(min(args.samples, len(recording))), task)
        fresh = partial(new_model, name, args.robot, task)
        wall, cpu = time.perf_counter(), time.process_time()
        fresh().fit(*samples, training)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        loads = load_averages()
        rows.append(
            {
                "task": task,
                "model": name,
                "samples": len(samples[0]),
                "epochs": args.epochs,
                "wall_minutes": wall / 60,
                "cpu_minutes": cpu / 60,
                "load_average": loads[0] if loads else None,
                "shares": _shares(fresh, samples, Training(epochs=1, precision=args.precision)),
            }
        )
    return {
        "title": "How long the arms' models take to train",
        "kind": "modelling-time",
        "robot": args.robot,
        "precision": args.precision,
        "rows": rows,
    }


def _shares(
    fresh: Callable[[], InverseModel], samples: tuple[FloatArray, FloatArray], training: Training
) -> dict[str, float]:
    """Compute each part's share of the process's time, over an epoch of few samples."""
    from torch.profiler import ProfilerActivity, profile

    inputs, outputs = (one[:SAMPLES_A_SIZE] for one in samples)
    fresh().fit(inputs, outputs, training)  # warm-up: the first run includes one-time setup
    model = fresh()
    began = time.perf_counter()
    with profile(activities=[ProfilerActivity.CPU]) as profiler:
        model.fit(inputs, outputs, training)
        whole = time.perf_counter() - began
    purposes = {operator: name for name, those in PARTS.items() for operator in those}
    parts: dict[str, float] = defaultdict(float)
    for event in profiler.key_averages():
        if event.key.startswith(("aten::", "autograd::")):
            purpose = purposes.get(event.key, "other operators")
            parts[purpose] += event.self_cpu_time_total * 1e-6
    parts["Python"] = max(0.0, whole - sum(parts.values()))
    total = sum(parts.values())
    return {name: parts[name] / total for name in (*PARTS, "other operators", "Python")}


def render(figures: dict[str, Any]) -> str:
    """Render the figures as a page.

    :param figures: what was measured, or the content of its JSON file.
    :return: Markdown.
    """
    columns: dict[str, Column] = {
        "task": lambda one: TASK_NAMES[one["task"]],
        "model": "{model}",
        "samples": "{samples:,}",
        "epochs": "{epochs}",
        "minutes": "{wall_minutes:.1f}",
        "of CPU": "{cpu_minutes:.1f}",
        "load": lambda one: "-" if one["load_average"] is None else f"{one['load_average']:.1f}",
    }
    columns |= {name: f"{{shares[{name}]:.0%}}" for name in figures["rows"][0]["shares"]}
    return page("modelling-time", columns=columns, **figures)
