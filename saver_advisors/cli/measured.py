"""Measure or read results, then print and write them."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from saver_advisors.cli.arguments import write_json
from saver_advisors.reporting.errors import UsageError, user_mistakes

if TYPE_CHECKING:
    from saver_advisors.experiments.training_runs import Results


def read_measurement(path: Path, kind: str) -> dict[str, Any]:
    """Read the JSON file of an earlier measurement, for ``--from``.

    :param path: of the file
    :param kind: required ``kind`` of the measurement
    :return: its content
    :raises UsageError: for a file that is unreadable, is not JSON, or has another kind
    """
    from saver_envs.files import read_json

    with user_mistakes("argument --from"):
        figures: Any = read_json(path)
    if not isinstance(figures, dict) or figures.get("kind") != kind:
        raise UsageError(f"argument --from: {path} does not hold figures of the kind {kind!r}")
    return figures


def measured_or_read(
    args: argparse.Namespace,
    kind: str,
    measure: Callable[[], Mapping[str, Any]],
) -> dict[str, Any]:
    """Measure, or read an earlier measurement where ``--from`` is given.

    :param args: with ``from_json``, as :func:`saver_advisors.cli.arguments.add_page` declares it
    :param kind: of the measurement
    :param measure: returns the results
    :return: the results with their provenance
    :raises UsageError: see :func:`read_measurement`
    """
    from saver_advisors.reporting.provenance import provenance

    if args.from_json is not None:
        return read_measurement(args.from_json, kind)
    origin = provenance()  # first: a measurement may write files into the checkout
    return {**measure(), "provenance": origin}


def read_training(paths: Sequence[Path]) -> Results:
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


def hand_over(
    page: str, figures: Mapping[str, Any], json_file: Path | None, table: Path | None
) -> None:
    """Print a page, and write results and page to the given files.

    :param page: Markdown
    :param figures: results with their provenance
    :param json_file: path for the results, or None
    :param table: path for the page, or None
    """
    print(page)
    write_json(json_file, figures)
    if table is not None:
        table.write_text(page, encoding="utf-8")
        print(f"wrote {table}")


def measure_and_render(
    args: argparse.Namespace,
    kind: str,
    measure: Callable[[], Mapping[str, Any]],
    render: Callable[[dict[str, Any]], str],
) -> int:
    """Measure or read figures, print their page, and write the requested files.

    Measurements run with one thread of linear algebra, as training does by default.

    :param args: with the arguments of :func:`saver_advisors.cli.arguments.add_page`
    :param kind: the kind of the figures, as their JSON file names it
    :param measure: takes the measurements
    :param render: turns figures into a page
    :return: exit status
    :raises UsageError: if ``--from`` names a file without such figures
    """
    from saver_advisors.training.threads import one_thread_of_algebra

    figures = measured_or_read(args, kind, one_thread_of_algebra()(measure))
    hand_over(render(figures), figures, args.json, args.table)
    return 0
