"""Parts that the commands' pages share: pictures, and the origins of figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from saver_advisors.reporting import provenance
from saver_advisors.reporting.figures import Drawn, link

JsonRow = Mapping[str, Any]


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
    packages = {"MuJoCo": "mujoco", "PyTorch": "torch", "Stable-Baselines3": "sb3"}
    return provenance.measured_at(figures, packages)
