"""Turn tutorials into notebooks: the Markdown page is the source, and no text exists twice."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from saver_advisors.cli.program import DISTRIBUTION

TUTORIALS: Final = ("first-policy", "your-own-task", "your-own-algorithm")
"""Pages that are notebooks as well."""
FOLDER: Final = "notebooks"
EXCERPT: Final = "from "
"""A title ``from FILE`` marks an excerpt of ``docs/examples/FILE``, which is not run."""
_BLOCK: Final = re.compile(
    r'^```(?P<language>\w+)(?: title="(?P<title>[^"]+)")?\n(?P<code>.*?)^```\n',
    re.DOTALL | re.MULTILINE,
)
_LINK: Final = re.compile(r"\]\((?!\w+:|#)")
_SHOWN: Final = re.compile(r"^saver .*--(?:video|output|figure) (\S+\.(?:mp4|png))", re.MULTILINE)

Cell = dict[str, Any]


def notebook(page: Path) -> str:
    """Return the notebook of a page, in nbformat 4.5, without outputs.

    The first cell installs the package; lines that install it in another way are left out. Lines
    of shell get a ``!``, a block with a file's name as its title writes that file, and videos and
    plots are shown below the command that makes them.

    :param page: Markdown; the examples of its excerpts are in ``examples`` next to it.
    :return: JSON.
    """
    cells = [_code(f'%pip install --quiet "{DISTRIBUTION}[train]"')]
    cells += _cells(page.read_text(encoding="utf-8"), page.parent / "examples")
    for index, cell in enumerate(cells):
        cell["id"] = f"cell-{index}"
    metadata = {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    content = {"cells": cells, "metadata": metadata, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(content, indent=1, ensure_ascii=False, sort_keys=True) + "\n"


def _cells(text: str, examples: Path) -> Iterator[Cell]:
    written: set[str] = set()
    end = 0
    for block in _BLOCK.finditer(text):
        yield from _text(text[end : block.start()])
        end = block.end()
        language, title, code = block.group("language", "title", "code")
        if title and title.startswith(EXCERPT):
            file = title.removeprefix(EXCERPT)
            if file not in written:
                written.add(file)
                source = (examples / file).read_text(encoding="utf-8")
                yield _code(f"%%writefile {file}\n{source}")
            yield from _text(block.group())
        elif title:
            yield _code(f"%%writefile {title}\n{code}")
        elif language == "python":
            yield _code(code)
        elif language == "bash":
            yield from _shell(code)
        else:
            yield from _text(block.group())
    yield from _text(text[end:])


def _shell(code: str) -> Iterator[Cell]:
    """Return the cell of a block of shell, and one that shows what its commands drew."""
    if "pip install" in code:
        return
    lines = code.strip().splitlines()
    begins = [True, *(not line.endswith("\\") for line in lines[:-1])]
    cell = [
        re.sub("^export ", "%env ", line) if line.startswith("export ") else "!" * begin + line
        for line, begin in zip(lines, begins, strict=True)
    ]
    yield _code("\n".join(cell))
    shown = [
        f'Video("{file}", embed=True)' if file.endswith(".mp4") else f'Image("{file}")'
        for file in _SHOWN.findall(code)
    ]
    if shown:
        displayed = "\n".join(f"display({one})" for one in shown)
        yield _code(f"from IPython.display import Image, Video, display\n\n{displayed}")


def _text(markdown: str) -> Iterator[Cell]:
    """Return a cell of text, whose links lead from the folder of notebooks to the pages."""
    if source := _LINK.sub("](../", markdown).strip():
        yield {"cell_type": "markdown", "metadata": {}, "source": source.splitlines(keepends=True)}


def _code(source: str) -> Cell:
    return {
        "cell_type": "code",
        "execution_count": None,
        "metadata": {},
        "outputs": [],
        "source": source.strip().splitlines(keepends=True),
    }
