"""Write the documentation pages that come from the code: environments, weights, results.

The README's tables, between their markers, are written as well.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from saver_advisors.cli.errors import UsageError

EXAMPLES = """\
examples:
  saver docs                          all of it, pictures and clips as well (minutes)
  saver docs --no-pictures            the text alone
  saver docs --check                  fails where a page differs from the code; writes nothing"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "--output",
        type=Path,
        default=Path("docs"),
        metavar="DIR",
        help="the documentation's folder (default: docs)",
    )
    parser.add_argument(
        "--readme",
        type=Path,
        metavar="FILE",
        help="whose tables are written as well (default: README.md beside the folder)",
    )
    parser.add_argument("--check", action="store_true", help="compare, write nothing")
    parser.add_argument("--no-pictures", action="store_true", help="draw nothing")
    parser.add_argument(
        "--only", nargs="+", default=None, metavar="ID", help="draw these environments alone"
    )


def run(args: argparse.Namespace) -> int:
    """Compare or write."""
    texts = _texts(args)
    stale = [path for path, text in texts.items() if not _holds(path, text)]
    if args.check:
        for path in stale:
            print(f"{path} differs from the code: run `saver docs`", file=sys.stderr)
        print(f"{len(texts) - len(stale)} of {len(texts)} pages are up to date")
        return 1 if stale else 0
    for path in stale:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(texts[path], encoding="utf-8")
        print(f"wrote {path}")
    if not args.no_pictures:
        from saver_advisors.cli.pages.pictures import draw_all

        draw_all(args.output, args.only)
    return 0


def _texts(args: argparse.Namespace) -> dict[Path, str]:
    """What every page should read."""
    from saver_advisors.cli.pages.generated import all_pages, with_tables

    output = args.output
    texts = {output / name: text for name, text in all_pages(output).items()}
    readme = args.readme or output.resolve().parent / "README.md"
    if args.readme is not None or readme.is_file():
        try:
            texts[readme] = with_tables(readme.read_text(encoding="utf-8"), output)
        except (OSError, ValueError) as error:
            raise UsageError(f"argument --readme: {error}") from error
    return texts


def _holds(path: Path, text: str) -> bool:
    return path.is_file() and path.read_text(encoding="utf-8") == text
