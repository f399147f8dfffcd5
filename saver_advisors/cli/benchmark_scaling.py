"""Measure how a grid of runs scales with workers: processes here, and nodes of a Ray cluster.

The nodes are started on this machine, with one processor each, so that more nodes than free cores
measure the machine and not the scheduler: the table has both the efficiency and the processor time
of the training alone.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any, Final

from saver_advisors.cli.measured import measure_and_render
from saver_envs.registration import ONE_ARM_ID

if TYPE_CHECKING:
    from pathlib import Path

EXAMPLES: Final = """\
examples:
  saver benchmark scaling --json scaling.json
  saver benchmark scaling --nodes 1 2 4 --runs 4 --steps 50000"""

KIND: Final = "scaling"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    from saver_advisors.cli import arguments

    count = arguments.at_least(1)
    arguments.add(parser, "--env", "environment", ONE_ARM_ID, type=arguments.env_id, metavar="ID")
    arguments.add_several(parser, "--nodes", count, (1, 2), "numbers of nodes, and of processes")
    arguments.add_count(parser, "--runs", 2, "runs of the grid per node")
    arguments.add_count(parser, "--steps", 4_000, "environment steps of a run")
    arguments.add_count(parser, "--rounds", 3, "checkpoints written and read")
    arguments.add_page(parser)


def run(args: argparse.Namespace) -> int:
    """Measure, print the tables, and write the given files.

    :param args: see :func:`add_arguments`
    :return: exit status
    """
    from saver_advisors.benchmark.scaling.scaling_page import render

    return measure_and_render(args, KIND, lambda: measure(args), render)


def measure(args: argparse.Namespace) -> dict[str, Any]:
    """Execute the grids, and time checkpoints.

    :param args: see :func:`add_arguments`
    :return: ``rows``, ``resuming_s`` and ``checkpoint``, with the conditions
    """
    import os
    import tempfile
    from pathlib import Path

    import ray  # noqa: F401  (needed after some of the work: say so before it)

    from saver_advisors.reporting.provenance import load_averages

    before = load_averages()
    with tempfile.TemporaryDirectory() as folder:
        figures = _figures(args, Path(folder))
    return {
        "title": "Scaling of a grid",
        "kind": KIND,
        "env": args.env,
        "steps": args.steps,
        "hardware_threads": os.cpu_count(),
        **figures,
        "load_average": {"before": before, "after": load_averages()},
    }


def _figures(args: argparse.Namespace, folder: Path) -> dict[str, Any]:
    from saver_advisors.benchmark.machine import progress
    from saver_advisors.benchmark.scaling.grid_scaling import (
        BACKENDS,
        checkpoint_row,
        resuming_s,
        scaling_row,
        timed_grid,
        with_efficiency,
    )
    from saver_advisors.experiments.scheduler import Places

    rows = []
    with progress("grids", len(BACKENDS) * len(args.nodes)) as advance:
        for backend in BACKENDS:
            for nodes in args.nodes:
                grid = timed_grid(args.env, args.steps, args.runs * nodes)
                own = folder / f"{backend}-{nodes}"
                rows.append(scaling_row(backend, nodes, grid, own))
                advance()
    first, places = grid.runs[0], Places(own, own / "results")
    return {
        "rows": with_efficiency(rows),
        "resuming_s": resuming_s(first, places),
        "checkpoint": checkpoint_row(first, folder / "checkpoint", args.rounds),
    }
