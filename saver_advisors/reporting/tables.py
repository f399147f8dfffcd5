"""Tables: on the terminal and in Markdown, from the same rows."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.table import Table

PLAIN_WIDTH = 160
"""Columns where the output is not a terminal, which has a width of its own."""


def table(columns: Sequence[str], rows: Sequence[Sequence[str]], title: str | None = None) -> Table:
    """A table for the terminal.

    :param columns: headings
    :param rows: cells, one list a row
    :param title: above it
    :return: what rich prints
    """
    from rich import box
    from rich.table import Table

    drawn = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for index, name in enumerate(columns):
        numbers = all(_is_number(row[index]) for row in rows)
        # Names and numbers stay whole; sentences and headings are folded between words.
        longest = max((len(word) for row in rows for word in row[index].split()), default=0)
        drawn.add_column(name, justify="right" if numbers else "left", min_width=longest)
    for row in rows:
        drawn.add_row(*row)
    return drawn


def show(columns: Sequence[str], rows: Sequence[Sequence[str]], title: str | None = None) -> None:
    """Print a table.

    :param columns: headings
    :param rows: cells, one list a row
    :param title: above it
    """
    from rich.console import Console

    width = None if sys.stdout.isatty() or "COLUMNS" in os.environ else PLAIN_WIDTH
    console = Console(width=width, highlight=False, markup=False)
    console.print(table(columns, rows, title))


def markdown(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown.

    :param columns: headings
    :param rows: cells, one list a row
    :return: the lines, the last with a line break
    """
    lines = [_line(columns), "|" + "---|" * len(columns)]
    lines += [_line(row) for row in rows]
    return "\n".join(lines) + "\n"


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _is_number(text: str) -> bool:
    return text.replace(",", "").replace(".", "", 1).lstrip("-").isdigit() or text in ("-", "")


def between_markers(text: str, begin: str, end: str, content: str) -> str:
    """A text with other content between two markers.

    :param text: of a page
    :param begin: the first marker
    :param end: the second
    :param content: what takes the place of the old
    :return: the new text
    :raises ValueError: where a marker is missing
    """
    before, opened, rest = text.partition(begin)
    _, closed, after = rest.partition(end)
    if not opened or not closed:
        raise ValueError(f"there is no {begin} and {end}")
    return f"{before}{begin}\n{content}{end}{after}"
