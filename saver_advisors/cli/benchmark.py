"""Measure speed and accuracy on this machine, and compare algorithms."""

from __future__ import annotations

import argparse
from typing import Final

from saver_advisors.cli.program import add_commands

EXAMPLES: Final = """\
examples:
  saver benchmark speed
  saver benchmark speed --help

To reproduce the dissertation's tables and figures, run
`python -m reproduction NAME` in a clone of the repository."""

KINDS: Final = {
    "speed": "measure environment steps per second, here and in other suites",
    "run": "train your own algorithm by the benchmark protocol",
    "compare": "compare your results with the baselines",
    "submit": "check your results, and add them to the leaderboard",
    "worlds": "evaluate policies in worlds that vary",
    "scaling": "measure how a grid scales with processes and nodes of a cluster",
    "pose": "measure pose estimation, here and in BlazePose",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of every benchmark."""
    kinds = {
        name: (f"saver_advisors.cli.benchmark_{name}", summary) for name, summary in KINDS.items()
    }
    add_commands(parser.add_subparsers(dest="kind", metavar="WHAT", required=True), kinds)


def run(args: argparse.Namespace) -> int:
    """Fail: each benchmark's parser replaces this function by its own ``run``.

    :raises AssertionError: always.
    """
    raise AssertionError("argparse requires WHAT")
