"""Parts that the commands' pages share: tables of JSON rows, pictures, origins of figures."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from saver_advisors.reporting.figures import Drawn, link
from saver_advisors.reporting.provenance import machine_in_words
from saver_advisors.reporting.tables import markdown

JsonRow = Mapping[str, Any]
Column = str | Callable[[Any], str]
"""A format string with a row's keys, such as ``{rms:.2f}``, or a function of the row."""


def rows_table(rows: Iterable[JsonRow], columns: Mapping[str, Column]) -> str:
    """Render JSON rows as a table.

    :param rows: the rows, each a mapping.
    :param columns: headings and how a row fills each.
    :return: Markdown.
    """
    return markdown(list(columns), row_cells(rows, columns.values()))


def row_cells(rows: Iterable[JsonRow], columns: Iterable[Column]) -> list[list[str]]:
    """Fill the cells of a table from JSON rows.

    :param rows: the rows, each a mapping.
    :param columns: how a row fills each column.
    :return: one list of cells per row.
    """
    columns = list(columns)
    return [
        [one.format_map(row) if isinstance(one, str) else one(row) for one in columns]
        for row in rows
    ]


def join_parts(parts: Iterable[str]) -> str:
    """Join the parts of a page with one empty line between them; empty parts are left out.

    :param parts: headings, paragraphs and tables.
    :return: Markdown that ends with a line break.
    """
    return "\n".join(part.rstrip("\n") + "\n" for part in parts if part)


def pictures(drawn: Sequence[Drawn], folder: Path) -> list[str]:
    """Show figures with their captions.

    :param drawn: figures on disk.
    :param folder: the page's folder, which the links start from.
    :return: one part of the page per figure.
    """
    return [f"![{one.caption}]({link(one.path, folder)})\n\n{one.caption}\n" for one in drawn]


def measured_at(figures: JsonRow) -> str:
    """Say when, at which commit, how and on which machine figures were measured.

    :param figures: content of a result file.
    :return: a sentence; empty without provenance.
    """
    origin = figures.get("provenance")
    if not origin:
        return ""
    versions = origin["versions"]
    return (
        f"Measured {origin['time']} at commit `{origin['commit']}` with `{origin['command']}` on "
        f"{machine_in_words(origin['machine'])}, PyTorch {versions['torch']}, Stable-Baselines3 "
        f"{versions['sb3']}."
    )
