"""The `saver` command line."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import metadata
from typing import Final

from saver_advisors.cli.program import DISTRIBUTION, Program

COMMANDS: Final = {
    "envs": "list the environments with their sizes, horizon, success and costs",
    "train": "train a policy, with or without advice from a teacher",
    "evaluate": "evaluate a policy on episodes with fixed seeds, and record videos",
    "view": "watch a policy in a browser or a window, and demonstrate by hand",
    "dataset": "write a data set of episodes, for learning offline",
    "export": "export a training run as a weight file with a card",
    "curves": "plot the learning curves of training runs",
    "experiments": "run a grid of training runs on this machine or on a cluster",
    "benchmark": "measure speed on this machine and compare algorithms",
    "pose": "estimate the poses of people in a picture or a video",
    "train-pose": "train a pose estimation network",
    "model": "make an arm's data set, train inverse models, search hyper-parameters",
    "run": "run the whole robot in a closed loop, from camera to servos",
    "demo": "play the shipped policies, train for two minutes and write a report page",
}

#: Commands that moved to the reproduction package; ``docs`` is called ``pages`` there.
MOVED: Final = {"docs": "python -m reproduction pages"} | {
    f"benchmark {name}": f"python -m reproduction {name}"
    for name in (
        *("advising", "constraints", "transfer", "ik", "id", "modelling"),
        *("kinematics", "tracking", "learning", "wrist-push", "safe"),
    )
}

DESCRIPTION: Final = """\
Environments for robots that move injured people, and a kit that trains policies for them."""

EXAMPLES: Final = """\
examples:
  saver envs                                             list the environments
  saver evaluate --env JacoPush-v0 --policy jaco-push    evaluate a shipped policy
  saver train --env JacoPush-v0 --output runs/push       train a policy
  saver demo --output demo_output                        a tour in six minutes

`saver COMMAND --help` describes a command and shows examples."""


def _version() -> str:
    try:
        return f"saver {metadata.version(DISTRIBUTION)}"
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
    extras={
        **{"dataset": "datasets", "view": "view"},
        **{"pose": "pose", "train-pose": "pose", "model": "modelling"},
    },
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run `saver`; see :meth:`Program.main`."""
    return SAVER.main(argv)
