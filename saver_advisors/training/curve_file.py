"""A run's learning curve on disk: one line of JSON an evaluation."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

from saver_envs.files import written_whole

CURVE_FILE: Final = "curve.jsonl"
#: Of a point, what two equal runs do not share.
OF_THE_MACHINE: Final = frozenset({"wall_clock_s", "load_average"})


def read_curve(folder: str | Path) -> list[dict[str, Any]]:
    """The points of a run's curve; a line that a crash left unfinished ends it.

    :param folder: of the run
    :return: one mapping an evaluation, none where there is no curve
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
    """Replace a run's curve as a whole.

    :param folder: of the run
    :param points: one mapping an evaluation
    """
    path = Path(folder) / CURVE_FILE
    with written_whole(path) as file:
        file.write("".join(_line(point) for point in points).encode("utf-8"))


def append_point(folder: str | Path, point: dict[str, Any]) -> None:
    """Add a point to a run's curve.

    :param folder: of the run
    :param point: of an evaluation
    :raises ValueError: for NaN or infinity, which JSON does not know
    """
    with open(Path(folder) / CURVE_FILE, "a", encoding="utf-8") as file:
        file.write(_line(point))


def _line(point: dict[str, Any]) -> str:
    return json.dumps(point, allow_nan=False) + "\n"
