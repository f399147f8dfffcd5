"""Measure speed on this machine: steps per second, beside the raw simulator and other suites."""

from __future__ import annotations

import argparse
import importlib
from typing import Any, Final

from saver_advisors.cli.errors import UsageError

EXAMPLES = """\
examples:
  saver benchmark speed
  saver benchmark speed --help"""

SPEED: Final = "saver_advisors.benchmarks.speed"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what is measured; ``speed`` declares its own arguments."""
    kinds = parser.add_subparsers(dest="kind", metavar="WHAT", required=True)
    speed = kinds.add_parser("speed", help="environment steps per second")
    measure = _speed()
    if measure is not None:
        measure.add_arguments(speed)


def run(args: argparse.Namespace) -> int:
    """Hand over to what was asked for."""
    measure = _speed()
    if measure is None:
        raise UsageError(f"this installation has no {SPEED}")
    return int(measure.run(args))


def _speed() -> Any:
    """The module that measures, or None where it is not there."""
    try:
        return importlib.import_module(SPEED)
    except ModuleNotFoundError as error:
        if error.name is None or not SPEED.startswith(error.name):
            raise  # it is there, and something that it needs is not
        return None
