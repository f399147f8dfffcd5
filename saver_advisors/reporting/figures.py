"""Figures on disk, and their links on pages."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Drawn:
    """A figure on disk.

    :param path: of the picture
    :param caption: below the picture
    """

    path: Path
    caption: str


def link(figure: Path, folder: Path) -> str:
    """Return the link from a page to a figure.

    :param figure: the picture
    :param folder: of the page
    :return: the relative path, with slashes
    """
    return Path(os.path.relpath(figure.resolve(), folder.resolve())).as_posix()
