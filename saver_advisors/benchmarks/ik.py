"""Inverse kinematics of chapter 7: the paper's networks and their peers, beside its own tables.

Every cell (model, data size, sigma, seed) is trained once and kept as a JSON file: a run that was
killed goes on where it was.
"""

from __future__ import annotations

import argparse
from typing import Final

from saver_advisors.benchmarks.modelling_command import declare, execute

EXAMPLES: Final = """\
examples:
  saver benchmark ik --robot mico --table mico-ik.md --json mico-ik.json
  saver benchmark ik --robot mico --sizes 1 --sigmas 0 --models mlp cgan --epochs 10
  saver benchmark ik --robot fetch --sizes 1 6 --sigmas 0 0.2 --seeds 0 1 --processes 2"""

MODELS: Final = (
    "mlp",
    "cgan",
    "lsgan",
    "bigan",
    "dualgan",
    "analytic",
    "conditional",
    "flow",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    declare(parser, MODELS)


def run(args: argparse.Namespace) -> int:
    """Train what is missing, show, and write where asked for.

    :param args: see :func:`add_arguments`
    :return: exit status
    """
    return execute(args, "ik")
