"""Figures that were measured earlier, and where measured figures go."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any


def read_measurement(path: Path, kind: str) -> dict[str, Any]:
    """An earlier measurement, as ``--from`` asks for it.

    :param path: of its JSON file
    :param kind: what the file must say that it holds
    :return: its content
    :raises UsageError: for a file that cannot be read, is no JSON, or holds something else
    """
    from saver_advisors.reporting.errors import UsageError

    try:
        figures = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"argument --from: {error}") from error
    except ValueError as error:
        raise UsageError(f"argument --from: {path} is not JSON: {error}") from error
    if not isinstance(figures, dict) or figures.get("kind") != kind:
        raise UsageError(f"argument --from: {path} does not hold figures of the kind {kind!r}")
    return figures


def measured_or_read(
    args: argparse.Namespace,
    kind: str,
    measure: Callable[[], Mapping[str, Any]],
) -> dict[str, Any]:
    """Figures with their provenance: measured now, or earlier where ``--from`` was given.

    :param args: with ``from_json``, as :func:`saver_advisors.cli.arguments.add_page` declares it
    :param kind: of the figures
    :param measure: takes the measurements
    :raises UsageError: see :func:`read_measurement`
    """
    from saver_advisors.reporting.provenance import provenance

    if args.from_json is not None:
        return read_measurement(args.from_json, kind)
    origin = provenance()  # before what is measured leaves files in the checkout
    return {**measure(), "provenance": origin}


def hand_over(
    page: str, figures: Mapping[str, Any], json_file: Path | None, table: Path | None
) -> None:
    """Print a page, and write figures and page where files were asked for.

    :param page: Markdown
    :param figures: with their provenance
    :param json_file: of the figures, or None
    :param table: of the page, or None
    """
    from saver_advisors.reporting.provenance import write_json_atomic

    print(page)
    if json_file is not None:
        write_json_atomic(json_file, figures)
        print(f"wrote {json_file}")
    if table is not None:
        table.write_text(page, encoding="utf-8")
        print(f"wrote {table}")
