"""Build a command line program from command modules, each imported when its command is called.

A command module has ``add_arguments(parser)`` and ``run(args) -> int``. It imports heavy packages
such as MuJoCo and torch inside ``run``, so that ``--help`` starts fast.
"""

from __future__ import annotations

import argparse
import errno
import importlib.util
import os
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import metadata
from typing import Any, Final, NoReturn

from saver_advisors.reporting.errors import UsageError

DISTRIBUTION: Final = "saver-envs"
#: Distributions whose module has another name.
OTHER_NAMES: Final = {"PIL": "pillow", "yaml": "pyyaml", "zmq": "pyzmq"}
#: Exit status after Ctrl-C, as in shells.
INTERRUPTED: Final = 130
DISK_ERRORS: Final = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EIO)
"""Errors of the system that a full disk, or one that may not be written to, leads to."""


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
    :param moved: names of commands that moved -> the command to call instead.
    :param examples: shown at the end of ``--help``.
    :param version: shown by ``--version``; no such option where empty.
    :param extras: names of commands -> the extra of the package that they need.
    :param usual_extra: what the other commands need.
    """

    name: str
    description: str
    commands: Mapping[str, tuple[str, str]]
    moved: Mapping[str, str] = field(default_factory=dict)
    examples: str = ""
    version: str = ""
    extras: Mapping[str, str] = field(default_factory=dict)
    usual_extra: str = "train"

    def parser(self, command: str | None = None) -> argparse.ArgumentParser:
        """Build the parser.

        :param command: the only command whose module is loaded; all of them if None, and none for
            the name of no command.
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
        for old in (" ".join(words[:1]), " ".join(words[:2])):
            if new := self.moved.get(old):
                print(f"{self.name}: error: '{self.name} {old}' is now '{new}'", file=sys.stderr)
                return 2
        command = words[0] if words else ""
        prefix = f"{self.name} {command}"
        parser = self.parser(command)
        try:
            args = parser.parse_args(arguments)
            if args.command is not None:
                return int(args.run(args))
        except UsageError as error:
            if "--traceback" in arguments:
                raise
            print(f"{prefix}: error: {error}", file=sys.stderr)
            return 2
        except ImportError as error:
            extra = missing_extra(error.name, self.extras.get(command, self.usual_extra))
            if extra is None or "--traceback" in arguments:
                raise
            install = f"pip install '{DISTRIBUTION}[{extra}]'"
            print(f"{prefix}: error: needs the package {error.name}: {install}", file=sys.stderr)
            return 2
        except BrokenPipeError:
            # The reader closed the pipe, as `head` does.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 0
        except OSError as error:
            if error.errno not in DISK_ERRORS or "--traceback" in arguments:
                raise
            print(f"{prefix}: error: {error}", file=sys.stderr)
            return 1
        except KeyboardInterrupt:
            print(f"{prefix}: interrupted", file=sys.stderr)
            return INTERRUPTED
        parser.print_help()
        return 0


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


def missing_extra(module: str | None, usual: str) -> str | None:
    """Find the extra of our package that brings a module.

    :param module: name of a module that could not be imported.
    :param usual: the extra to name if several bring it.
    :return: name of the extra; None if no extra lists the module, or if it is installed.
    """
    top = (module or "sys").partition(".")[0]
    if importlib.util.find_spec(top) is not None:
        return None
    wanted = OTHER_NAMES.get(top, top).replace("_", "-").lower()
    extras = []
    for requirement in metadata.requires(DISTRIBUTION) or ():
        name, _, extra = requirement.partition("extra ==")
        if re.split(r"[^\w.-]", name)[0].replace("_", "-").lower() == wanted and extra:
            extras.append(extra.strip(" \"')"))
    return usual if usual in extras else next(iter(extras), None)


def _choose_renderer() -> None:
    """Select EGL on Linux without a display; MuJoCo reads the variable when imported."""
    screen = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform == "linux" and not screen:
        os.environ.setdefault("MUJOCO_GL", "egl")
