"""Measure speed and accuracy on this machine, and compare methods."""

from __future__ import annotations

import argparse
from typing import Final

from saver_advisors.cli.program import add_commands

EXAMPLES: Final = """\
examples:
  saver benchmark speed
  saver benchmark speed --help

What reproduces the dissertation's tables and figures is called by
`python -m reproduction NAME` from a clone of the repository."""

KINDS: Final = {
    "speed": ("saver_advisors.cli.benchmark_speed", "environment steps per second, beside peers"),
    "run": ("saver_advisors.cli.benchmark_run", "an algorithm of yours, by our protocol"),
    "compare": ("saver_advisors.cli.benchmark_compare", "results of yours beside the baselines"),
    "pose": ("saver_advisors.cli.benchmark_pose", "people found in pictures, beside BlazePose"),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of every benchmark."""
    add_commands(parser.add_subparsers(dest="kind", metavar="WHAT", required=True), KINDS)


def run(args: argparse.Namespace) -> int:
    """Run the benchmark: its own ``run`` takes the place of this one when the line is parsed.

    :raises AssertionError: always; argparse requires a benchmark.
    """
    raise AssertionError("argparse requires WHAT")
