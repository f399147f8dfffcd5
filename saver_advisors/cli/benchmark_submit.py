"""Check result files of `saver benchmark run` by the protocol, and add them to the leaderboard.

Every violated rule is named with what would be right. Valid files are copied with the name of who
submits them; a pull request with the copies puts them on the leaderboard. If any file violates a
rule, none is copied.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any, Final

from saver_advisors.cli.arguments import add, add_folder, add_path
from saver_advisors.reporting.errors import UsageError

EXAMPLES: Final = """\
examples:
  saver benchmark submit results/*.json --by "A. Author" --link https://example.org/mine"""

SUBMISSIONS: Final = Path("docs/results/leaderboard")
"""Folder of the submissions in a clone."""


def author(text: str) -> str:
    """Parse the name of who submits, for argparse.

    :param text: as given
    :return: the same
    """
    from saver_advisors.benchmark.submission import NAME, NAME_RULE

    if not NAME.fullmatch(text):
        raise argparse.ArgumentTypeError(f"{text!r} {NAME_RULE}")
    return text


def address(text: str) -> str:
    """Parse the address of a method's page, for argparse.

    :param text: as given
    :return: the same
    """
    from saver_advisors.benchmark.submission import LINK

    if not LINK.fullmatch(text):
        raise argparse.ArgumentTypeError(f"{text!r} must be an address: https://...")
    return text


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_path(parser, "files", "results, one per seed", metavar="FILE", nargs="+")
    add(parser, "--by", "who submits them", type=author, metavar="NAME", required=True)
    add(parser, "--link", "page of the method: its code or its paper", type=address, metavar="URL")
    text = f"folder of the submissions (default: {SUBMISSIONS} in a clone)"
    add_folder(parser, "--to", text)


def run(args: argparse.Namespace) -> int:
    """Check the files, and copy them if all are valid.

    :param args: see :func:`add_arguments`
    :return: exit status
    :raises UsageError: for a file that violates a rule
    """
    from saver_advisors.benchmark.submission import file_name
    from saver_advisors.evaluation.protocol import SEEDS
    from saver_advisors.reporting.provenance import write_json_atomic

    folder = _folder(args.to)
    earlier, contents = _checked(args, folder)
    folder.mkdir(parents=True, exist_ok=True)
    for content in contents:
        path = folder / file_name(content)
        write_json_atomic(path, {k: v for k, v in content.items() if k != "file"})
        print(f"wrote {path}")
    methods = [(one["task"], one["row"]) for one in (*earlier, *contents)]
    for task, row in dict.fromkeys((one["task"], one["row"]) for one in contents):
        if (count := methods.count((task, row))) < SEEDS:
            print(f"{row} has {count} of {SEEDS} seeds in {task}: the leaderboard marks it")
    return 0


def _folder(given: Path | None) -> Path:
    if given is None and not SUBMISSIONS.parent.is_dir():
        raise UsageError(
            f"argument --to: needed here, where there is no {SUBMISSIONS.parent}: give a folder, "
            "or run this in a clone of the repository"
        )
    return given or SUBMISSIONS


Contents = list[dict[str, Any]]


def _checked(args: argparse.Namespace, folder: Path) -> tuple[Contents, Contents]:
    """Return the earlier submissions, and the contents of the files with who submits them.

    :raises UsageError: if one of them violates a rule, after all violated rules are printed
    """
    from saver_advisors.benchmark.submission import conflicts, read_checked

    contents, refused = read_checked(args.files)
    for content in contents:
        content["submission"] = {"by": args.by, "link": args.link}
    earlier, _ = read_checked(sorted(folder.glob("*.json")))
    refused += conflicts([*earlier, *contents])
    for one in refused:
        print(f"{one.file}: {one.reason}", file=sys.stderr)
    if refused:
        raise UsageError(
            f"argument FILE: {len(refused)} violations of the protocol, which are listed above; "
            "nothing was copied"
        )
    return earlier, contents
