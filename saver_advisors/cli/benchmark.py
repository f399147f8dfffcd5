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
    "speed": ("saver_advisors.benchmarks.speed", "environment steps per second, beside peers"),
    "learning": ("saver_advisors.benchmarks.learning", "where training's time goes, beside SB3"),
    "run": ("saver_advisors.benchmarks.protocol_run", "an algorithm of yours, by our protocol"),
    "compare": ("saver_advisors.benchmarks.compare", "results of yours beside the baselines"),
    "advising": ("saver_advisors.benchmarks.advising", "table 5.2's counterpart, and its findings"),
    "pose": ("saver_advisors.benchmarks.pose", "people found in pictures, beside BlazePose"),
    "transfer": ("saver_advisors.benchmarks.transfer", "policies of the Jaco on other arms"),
    "ik": ("saver_advisors.benchmarks.ik", "inverse kinematics of chapter 7, beside its tables"),
    "id": ("saver_advisors.benchmarks.id", "inverse dynamics of chapter 7, beside its tables"),
    "modelling": (
        "saver_advisors.benchmarks.modelling_time",
        "minutes to train chapter 7's models",
    ),
    "kinematics": ("saver_advisors.benchmarks.kinematics", "learned inverse kinematics in use"),
    "tracking": ("saver_advisors.benchmarks.tracking", "feed-forward torques on the twins"),
    "constraints": ("saver_advisors.benchmarks.constraints", "chapter 6: rates and findings"),
    "wrist-push": ("saver_advisors.benchmarks.wrist_push", "the whole robot, beside chapter 8"),
    "safe": ("saver_advisors.benchmarks.safe", "CPO and Lagrangians where the optimum is known"),
}
"""What can be measured: the module, which has `add_arguments(parser)` and `run(args) -> int` as a
command has, and a line of help. One row a benchmark, and nothing else to edit here.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Let every benchmark declare its own arguments."""
    kinds = parser.add_subparsers(dest="kind", metavar="WHAT", required=True)
    for name, (module_name, summary) in KINDS.items():
        measure: Any = importlib.import_module(module_name)
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
