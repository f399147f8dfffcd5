"""A run's learning curve as a file: one line of JSON per evaluation."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

from saver_envs.files import written_whole

CURVE_FILE: Final = "curve.jsonl"
#: Entries of a point that differ between two equal runs.
OF_THE_MACHINE: Final = frozenset({"wall_clock_s", "load_average"})


def read_curve(folder: str | Path) -> list[dict[str, Any]]:
    """Read the points of a run's curve, up to a line that a crash left incomplete.

    :param folder: the run's folder.
    :return: one mapping per evaluation; empty if there is no curve.
    """
    path = Path(folder) / CURVE_FILE
    points: list[dict[str, Any]] = []
    if path.is_file():
        for text in path.read_text(encoding="utf-8").splitlines():
            try:
                points.append(json.loads(text))
            except ValueError:
                break
    return points


def write_curve(folder: str | Path, points: list[dict[str, Any]]) -> None:
    """Replace a run's curve, atomically.

    :param folder: the run's folder.
    :param points: one mapping per evaluation.
    """
    with written_whole(Path(folder) / CURVE_FILE) as file:
        file.writelines(_line(point).encode("utf-8") for point in points)


def append_point(folder: str | Path, point: dict[str, Any]) -> None:
    """Append a point to a run's curve.

    :param folder: the run's folder.
    :param point: figures of an evaluation.
    :raises ValueError: for NaN or infinity, which JSON does not support.
    """
    with open(Path(folder) / CURVE_FILE, "a", encoding="utf-8") as file:
        file.write(_line(point))


def _line(point: dict[str, Any]) -> str:
    return json.dumps(point, allow_nan=False) + "\n"
