"""Format tables for the terminal and in Markdown."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.table import Table

PLAIN_WIDTH = 160
"""Width in characters if the output is not a terminal."""

Column = str | Callable[[Any], str]
"""A format string with a row's keys, such as ``{rms:.2f}``, or a function of the row."""


def table(columns: Sequence[str], rows: Sequence[Sequence[str]], title: str | None = None) -> Table:
    """Build a table for the terminal.

    :param columns: headings
    :param rows: cells, one list per row
    :param title: above the table
    """
    from rich import box
    from rich.table import Table

    drawn = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for index, name in enumerate(columns):
        numbers = all(_is_number(row[index]) for row in rows)
        # Wrap between words, so that names and numbers stay whole.
        longest = max((len(word) for row in rows for word in row[index].split()), default=0)
        drawn.add_column(name, justify="right" if numbers else "left", min_width=longest)
    for row in rows:
        drawn.add_row(*row)
    return drawn


def show(columns: Sequence[str], rows: Sequence[Sequence[str]], title: str | None = None) -> None:
    """Print a table.

    :param columns: headings
    :param rows: cells, one list per row
    :param title: above the table
    """
    from rich.console import Console

    width = None if sys.stdout.isatty() or "COLUMNS" in os.environ else PLAIN_WIDTH
    console = Console(width=width, highlight=False, markup=False)
    console.print(table(columns, rows, title))


def show_rows(rows: Iterable[Any], columns: Mapping[str, Column], title: str | None = None) -> None:
    """Print rows as a table.

    :param rows: see :func:`rows_table`.
    :param columns: headings and how a row fills each.
    :param title: above the table
    """
    show(list(columns), row_cells(rows, columns.values()), title)


def show_records(records: Sequence[Mapping[str, str]], title: str) -> None:
    """Print cells with their headings as a table; nothing without rows.

    :param records: heading -> cell, one mapping per row.
    :param title: above the table
    """
    if records:
        show(list(records[0]), [list(row.values()) for row in records], title)


def markdown(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Format a table in Markdown.

    :param columns: headings
    :param rows: cells, one list per row
    :return: the lines, the last with a line break
    """
    lines = [_line(columns), "|" + "---|" * len(columns)]
    lines += [_line(row) for row in rows]
    return "\n".join(lines) + "\n"


def records_table(records: Iterable[Mapping[str, str]]) -> str:
    """Render cells with their headings as a table in Markdown.

    :param records: heading -> cell, one mapping per row.
    :return: the lines, the last with a line break; empty without rows.
    """
    rows = list(records)
    return markdown(list(rows[0]), [list(row.values()) for row in rows]) if rows else ""


def rows_table(rows: Iterable[Any], columns: Mapping[str, Column]) -> str:
    """Render rows as a table in Markdown.

    :param rows: mappings, such as rows of a JSON file, or any objects if all columns are functions.
    :param columns: headings and how a row fills each.
    :return: the lines, the last with a line break.
    """
    return markdown(list(columns), row_cells(rows, columns.values()))


def optional(name: str, form: str = ".2f", unit: float = 1.0) -> Column:
    """Return a column of a figure that some rows lack, which show a dash.

    :param name: key of the figure in a row
    :param form: format of the figure
    :param unit: by which it is divided
    """
    return lambda row: "-" if row.get(name) is None else format(row[name] / unit, form)


def row_cells(rows: Iterable[Any], columns: Iterable[Column]) -> list[list[str]]:
    """Fill the cells of a table from rows.

    :param rows: see :func:`rows_table`.
    :param columns: how a row fills each column.
    :return: one list of cells per row.
    """
    columns = list(columns)
    return [
        [one.format_map(row) if isinstance(one, str) else one(row) for one in columns]
        for row in rows
    ]


def link(figure: Path, folder: Path) -> str:
    """Return the link from a page to a figure.

    :param figure: the picture
    :param folder: of the page
    :return: the relative path, with slashes
    """
    return Path(os.path.relpath(figure.resolve(), folder.resolve())).as_posix()


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _is_number(text: str) -> bool:
    return text.replace(",", "").replace(".", "", 1).lstrip("-").isdigit() or text in ("-", "")
