"""The files of training runs that a command reads."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from saver_advisors.experiments.training_runs import Results


def add_result_arguments(parser: argparse.ArgumentParser, results: Path) -> None:
    """``--results``, ``--table``, ``--figures`` and ``--json``, of what is told from runs' files.

    :param parser: gets them
    :param results: the folder that is read by default
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
        "--figures", type=Path, metavar="DIR", help="draw the figures there, made if need be"
    )
    add_json(parser)


def read(paths: Sequence[Path]) -> Results:
    """The results in files and folders.

    :param paths: as given to ``--results``
    :return: what they hold
    :raises UsageError: for a path that does not exist, or where there is no training run
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
