"""Read the result files that a command is given."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from saver_advisors.reporting.errors import UsageError, user_mistakes

if TYPE_CHECKING:
    from saver_advisors.experiments.training_runs import Results


def read(paths: Sequence[Path]) -> Results:
    """Read training runs and evaluations.

    :param paths: files and folders, as given to ``--results``
    :raises UsageError: for a missing path, or if there is no training run
    """
    from saver_advisors.experiments.training_runs import read_training_runs

    with user_mistakes("argument --results"):
        results = read_training_runs(paths)
    if not results.runs:
        left_out = "; ".join(f"{one.file} {one.reason}" for one in results.skipped)
        raise UsageError(
            f"argument --results: no training run in {', '.join(map(str, paths))}"
            + (f" ({left_out})" if left_out else "")
        )
    return results
