"""The `saver` command: one module a command, loaded when that command is asked for.

A command module has `add_arguments(parser)` and `run(args) -> int`, and imports simulator, torch
and the like inside `run`, so that `saver --help` answers at once.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Sequence
from importlib import metadata
from typing import Final, NoReturn

from saver_advisors.cli.errors import UsageError

COMMANDS: Final = {
    "envs": "list the environments: sizes, horizon, what succeeds, what costs",
    "train": "train a policy, alone or with the advice of a teacher",
    "evaluate": "measure a policy over episodes with fixed seeds, and record it",
    "export": "turn a training run into a weight file with a card",
    "curves": "draw the learning curves of training runs",
    "experiments": "work a grid of training runs off, on this machine or a cluster",
    "benchmark": "measure speed on this machine, and methods beside one another",
    "pose": "find the people in a picture or a video",
    "train-pose": "train a network that finds people",
    "model": "model an arm: its data set, inverse models, their hyper-parameters",
    "run": "run the whole robot, from camera to servos, in one closed loop",
    "demo": "play the shipped policies, learn for two minutes, write a page about it",
    "docs": "write the documentation pages that come from the code",
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

INTERRUPTED: Final = 130
"""Exit status after Ctrl-C, as shells have it."""


class _Parser(argparse.ArgumentParser):
    """One line for a mistake, instead of the whole usage."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: error: {message} (see {self.prog} --help)\n")


def build_parser(command: str | None = None) -> argparse.ArgumentParser:
    """The parser of the command line.

    :param command: the only command whose module is loaded; all of them where None
    :return: the parser
    """
    parser = _Parser(
        prog="saver",
        description=DESCRIPTION,
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=_version())
    parser.add_argument(
        "--traceback", action="store_true", help="show where in the code an error arose"
    )
    commands = parser.add_subparsers(title="commands", dest="command", metavar="COMMAND")
    for name, summary in COMMANDS.items():
        if command in (None, name):
            module = importlib.import_module(f"saver_advisors.cli.{name.replace('-', '_')}")
            sub = commands.add_parser(
                name,
                help=summary,
                description=module.__doc__.split("\n\n")[0] if module.__doc__ else summary,
                epilog=getattr(module, "EXAMPLES", None),
                formatter_class=argparse.RawDescriptionHelpFormatter,
            )
            module.add_arguments(sub)
            sub.set_defaults(run=module.run)
        else:
            commands.add_parser(name, help=summary)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    :param argv: arguments after the program's name; those of the process where None
    :return: exit status: 0, 2 for a mistake of the user's, 130 after Ctrl-C
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    _choose_renderer()
    named = next((word for word in arguments if not word.startswith("-")), None)
    parser = build_parser(named)
    args = parser.parse_args(arguments)
    if args.command is None:
        parser.print_help()
        return 0
    try:
        status: int = args.run(args)
    except UsageError as error:
        if args.traceback:
            raise
        print(f"saver {args.command}: error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"saver {args.command}: interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        # The reader of our output has gone, as `head` does: nobody is left to complain to.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    return status


def _choose_renderer() -> None:
    """Draw through EGL on a Linux machine without a screen; MuJoCo looks when it is imported."""
    screen = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform == "linux" and not screen:
        os.environ.setdefault("MUJOCO_GL", "egl")


def _version() -> str:
    try:
        return f"saver {metadata.version('saver-envs')}"
    except metadata.PackageNotFoundError:
        return "saver (not installed)"
