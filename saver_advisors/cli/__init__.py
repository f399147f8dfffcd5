"""The `saver` command line."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from importlib import metadata
from typing import Final

from saver_advisors.cli.program import Program

COMMANDS: Final = {
    "envs": "list the environments: sizes, horizon, what succeeds, what costs",
    "train": "train a policy, alone or with the advice of a teacher",
    "evaluate": "measure a policy over episodes with fixed seeds, and record it",
    "export": "turn a training run into a weight file with a card",
    "curves": "draw the learning curves of training runs",
    "experiments": "run a grid of training runs, on this machine or a cluster",
    "benchmark": "measure speed on this machine, and compare methods",
    "pose": "find the people in a picture or a video",
    "train-pose": "train a network that finds people",
    "model": "model an arm: its data set, inverse models, their hyper-parameters",
    "run": "run the whole robot, from camera to servos, in one closed loop",
    "demo": "play the shipped policies, learn for two minutes, write a page about it",
}

#: What reproduces the dissertation left the installed package.
MOVED: Final = {
    **{
        f"benchmark {name}": f"python -m reproduction {name}"
        for name in (
            "advising",
            "constraints",
            "transfer",
            "ik",
            "id",
            "modelling",
            "kinematics",
            "tracking",
            "learning",
            "wrist-push",
            "safe",
        )
    },
    "docs": "python -m reproduction pages",
}

DESCRIPTION: Final = """\
Environments for robots that move injured people, and a kit that trains policies for them."""

EXAMPLES: Final = """\
examples:
  saver envs                                             what is there
  saver evaluate --env JacoPush-v0 --policy jaco-push    how good a shipped policy is
  saver train --env JacoPush-v0 --output runs/push       a policy of your own
  saver demo --output demo_output                        all of it in six minutes

`saver COMMAND --help` explains a command, with examples."""


def _version() -> str:
    try:
        return f"saver {metadata.version('saver-envs')}"
    except metadata.PackageNotFoundError:
        return "saver (not installed)"


SAVER: Final = Program(
    name="saver",
    description=DESCRIPTION,
    commands={
        name: (f"saver_advisors.cli.{name.replace('-', '_')}", summary)
        for name, summary in COMMANDS.items()
    },
    moved=MOVED,
    examples=EXAMPLES,
    version=_version(),
)


def build_parser(command: str | None = None) -> argparse.ArgumentParser:
    """Build the parser of `saver`; see :meth:`Program.parser`."""
    return SAVER.parser(command)


def main(argv: Sequence[str] | None = None) -> int:
    """Run `saver`; see :meth:`Program.main`."""
    return SAVER.main(argv)
