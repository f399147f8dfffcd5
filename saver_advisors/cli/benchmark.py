"""Measure on this machine: speed, and methods beside one another."""

from __future__ import annotations

import argparse
import importlib
from typing import Any, Final

EXAMPLES: Final = """\
examples:
  saver benchmark speed
  saver benchmark speed --help"""

KINDS: Final = {
    "speed": ("speed.command", "environment steps per second, beside peers"),
    "learning": ("learning.command", "where training's time goes, beside SB3"),
    "run": ("protocol.run", "an algorithm of yours, by our protocol"),
    "compare": ("protocol.compare", "results of yours beside the baselines"),
    "advising": ("advising.command", "table 5.2's counterpart, and its findings"),
    "pose": ("pose.command", "people found in pictures, beside BlazePose"),
    "transfer": ("transfer.command", "policies of the Jaco on other arms"),
    "ik": ("modelling.ik", "inverse kinematics of chapter 7, beside its tables"),
    "id": ("modelling.id", "inverse dynamics of chapter 7, beside its tables"),
    "modelling": ("modelling.training_time", "minutes to train chapter 7's models"),
    "kinematics": ("modelling.kinematics", "learned inverse kinematics in use"),
    "tracking": ("modelling.tracking", "feed-forward torques on the twins"),
    "constraints": ("constraints.command", "chapter 6: rates and findings"),
    "wrist-push": ("wrist_push.command", "the whole robot, beside chapter 8"),
    "safe": ("constraints.known_problem", "CPO and Lagrangians where the optimum is known"),
}
"""What can be measured: the module, below `saver_advisors.benchmarks`, which has
`add_arguments(parser)` and `run(args) -> int` as a command has, and a line of help. One row a
benchmark, and nothing else to edit here.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Let every benchmark declare its own arguments."""
    kinds = parser.add_subparsers(dest="kind", metavar="WHAT", required=True)
    for name, (module_name, summary) in KINDS.items():
        measure: Any = importlib.import_module(f"saver_advisors.benchmarks.{module_name}")
        sub = kinds.add_parser(
            name,
            help=summary,
            description=measure.__doc__.split("\n\n")[0],
            epilog=getattr(measure, "EXAMPLES", None),
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        measure.add_arguments(sub)
        sub.set_defaults(measure=measure)


def run(args: argparse.Namespace) -> int:
    """Hand over to what was asked for."""
    return int(args.measure.run(args))
