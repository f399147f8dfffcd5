"""Build a command line program from command modules, each imported when its command is called.

A command module has ``add_arguments(parser)`` and ``run(args) -> int``. It imports heavy packages
such as MuJoCo and torch inside ``run``, so that ``--help`` starts fast.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NoReturn

from saver_advisors.reporting.errors import UsageError

#: Exit status after Ctrl-C, as in shells.
INTERRUPTED: Final = 130


class Parser(argparse.ArgumentParser):
    """Report an error in one line instead of printing the usage."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: error: {message} (see {self.prog} --help)\n")


@dataclass(frozen=True)
class Program:
    """A command line program.

    :param name: what the user types.
    :param description: shown by ``--help``.
    :param commands: name -> module and a line of help.
    :param moved: names of commands that moved elsewhere -> the command to call instead.
    :param examples: shown at the end of ``--help``.
    :param version: shown by ``--version``; no such option where empty.
    """

    name: str
    description: str
    commands: Mapping[str, tuple[str, str]]
    moved: Mapping[str, str] = field(default_factory=dict)
    examples: str = ""
    version: str = ""

    def parser(self, command: str | None = None) -> argparse.ArgumentParser:
        """Build the parser.

        :param command: the only command whose module is loaded; all of them if None.
        :return: the parser.
        """
        parser = Parser(
            prog=self.name,
            description=self.description,
            epilog=self.examples,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        if self.version:
            parser.add_argument("--version", action="version", version=self.version)
        parser.add_argument(
            "--traceback", action="store_true", help="show the traceback of an error"
        )
        subparsers = parser.add_subparsers(title="commands", dest="command", metavar="COMMAND")
        add_commands(subparsers, self.commands, command)
        return parser

    def main(self, argv: Sequence[str] | None = None) -> int:
        """Run a command.

        :param argv: arguments after the program's name; those of the process if None.
        :return: exit status: 0, 2 for a usage error, 130 after Ctrl-C.
        """
        arguments = list(sys.argv[1:] if argv is None else argv)
        _choose_renderer()
        words = [word for word in arguments if not word.startswith("-")]
        for depth in (1, 2):
            if new := self.moved.get(" ".join(words[:depth])):
                moved = " ".join(words[:depth])
                print(f"{self.name}: error: '{self.name} {moved}' is now '{new}'", file=sys.stderr)
                return 2
        args = self.parser(words[0] if words else None).parse_args(arguments)
        if args.command is None:
            self.parser(None).print_help()
            return 0
        return self._run(args)

    def _run(self, args: argparse.Namespace) -> int:
        prefix = f"{self.name} {args.command}"
        try:
            status: int = args.run(args)
        except UsageError as error:
            if args.traceback:
                raise
            print(f"{prefix}: error: {error}", file=sys.stderr)
            return 2
        except KeyboardInterrupt:
            print(f"{prefix}: interrupted", file=sys.stderr)
            return INTERRUPTED
        except BrokenPipeError:
            # The reader closed the pipe, as `head` does.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 0
        return status


def add_commands(
    subparsers: Any, commands: Mapping[str, tuple[str, str]], only: str | None = None
) -> None:
    """Declare commands and their arguments.

    :param subparsers: what ``add_subparsers`` returned.
    :param commands: name -> module and a line of help.
    :param only: the only command whose module is loaded; all of them if None.
    """
    for name, (module_name, summary) in commands.items():
        if only not in (None, name):
            subparsers.add_parser(name, help=summary)
            continue
        module: Any = importlib.import_module(module_name)
        parser = subparsers.add_parser(
            name,
            help=summary,
            description=module.__doc__.split("\n\n")[0] if module.__doc__ else summary,
            epilog=getattr(module, "EXAMPLES", None),
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        module.add_arguments(parser)
        parser.set_defaults(run=module.run)


def _choose_renderer() -> None:
    """Select EGL on Linux without a display; MuJoCo reads the variable when imported."""
    screen = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform == "linux" and not screen:
        os.environ.setdefault("MUJOCO_GL", "egl")
