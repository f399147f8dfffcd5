"""Render the gallery: the clips that lie in ``docs/images``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from reproduction.page_templates import page

#: Heading and page of the folders with clips besides those of the environments.
FOLDERS: Final = {
    "worlds": ("Worlds that vary", "worlds.md"),
    "transfer": ("Policies of two Jacos on two MICOs", "transfer.md"),
}


def gallery_page(images: Path, ids: Sequence[str]) -> str:
    """Render the page with every clip.

    :param images: folder of the pictures; its ``<folder>/*.webp`` are listed.
    :param ids: of the environments, each with a clip of its own.
    :return: Markdown.
    """
    sections = []
    for folder, (heading, about) in FOLDERS.items():
        names = sorted(path.stem for path in (images / folder).glob("*.webp"))
        clips = [{"name": _caption(name), "path": f"{folder}/{name}.webp"} for name in names]
        sections.append({"heading": heading, "page": about, "clips": clips})
    return page("gallery", ids=ids, sections=sections)


def _caption(name: str) -> str:
    """Return ``pick: grasp lost`` for ``pick-grasp-lost``; ids stay as they are."""
    if name.endswith("-v0"):
        return name
    task, _, outcome = name.partition("-")
    return f"{task}: {outcome.replace('-', ' ')}"
