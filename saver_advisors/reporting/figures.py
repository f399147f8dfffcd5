"""Figures on disk, and how a page links them."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Drawn:
    """A figure on disk.

    :param path: of the picture
    :param caption: what it shows
    """

    path: Path
    caption: str


def link(figure: Path, folder: Path) -> str:
    """Where a figure is, as a page links it.

    :param figure: the picture
    :param folder: of the page
    :return: the relative path, with slashes
    """
    return Path(os.path.relpath(figure.resolve(), folder.resolve())).as_posix()
