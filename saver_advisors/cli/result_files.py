"""Read the files of training runs that a command is given."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from saver_advisors.experiments.training_runs import Results


def add_result_arguments(parser: argparse.ArgumentParser, results: Path) -> None:
    """Add ``--results``, ``--table``, ``--figures`` and ``--json``.

    :param parser: of the command
    :param results: default folder of results
    """
    from saver_advisors.cli.arguments import add_json, add_table

    parser.add_argument(
        "--results",
        nargs="+",
        type=Path,
        default=[results],
        metavar="PATH",
        help="folders of result files, and such files: training runs, the figures of `saver "
        f"curves`, evaluations of policies to stand beside them (default: {results})",
    )
    add_table(parser)
    parser.add_argument(
        "--figures", type=Path, metavar="DIR", help="write the figures to this folder"
    )
    add_json(parser)


def read(paths: Sequence[Path]) -> Results:
    """Read training runs and evaluations.

    :param paths: files and folders, as given to ``--results``
    :return: their results
    :raises UsageError: for a missing path, or where there is no training run
    """
    from saver_advisors.experiments.training_runs import read_training_runs
    from saver_advisors.reporting.errors import UsageError, user_mistakes

    with user_mistakes("argument --results"):
        results = read_training_runs(paths)
    if not results.runs:
        left_out = "; ".join(f"{one.file} {one.reason}" for one in results.skipped)
        raise UsageError(
            f"argument --results: no training run in {', '.join(map(str, paths))}"
            + (f" ({left_out})" if left_out else "")
        )
    return results
