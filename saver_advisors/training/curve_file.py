"""A run's learning curve as a file: one line of JSON per evaluation."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

from saver_envs.files import written_whole

CURVE_FILE: Final = "curve.jsonl"
#: Entries that every point has.
POINT: Final = ("steps", "success_rate", "wall_clock_s")
#: Entries of a point that differ between two equal runs.
OF_THE_MACHINE: Final = frozenset({"wall_clock_s", "processor_s", "load_average"})


def read_curve(folder: str | Path) -> list[dict[str, Any]]:
    """Read the points of a run's curve, without a last line that a crash left incomplete.

    :param folder: the run's folder.
    :return: one mapping per evaluation; empty if there is no curve.
    :raises ValueError: for another line that is not the point of a curve; the message names it.
    """
    path = Path(folder) / CURVE_FILE
    lines = path.read_bytes().splitlines(True) if path.is_file() else []
    points: list[dict[str, Any]] = []
    for number, text in enumerate(lines, 1):
        try:
            point = json.loads(text)
        except (ValueError, RecursionError) as error:
            if number == len(lines) and not text.endswith(b"\n"):
                break
            raise ValueError(f"{path}: line {number} is not JSON: {error}") from error
        if not is_point(point):
            raise ValueError(f"{path}: line {number} must have {', '.join(POINT)} as numbers")
        points.append(point)
    return points


def is_point(value: Any) -> bool:
    """Return whether a value is the point of a curve: a mapping with the numbers of ``POINT``."""
    return isinstance(value, dict) and all(
        isinstance(value.get(name), (int, float)) and not isinstance(value[name], bool)
        for name in POINT
    )


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
    :raises OSError: if it cannot be written; the message names the file.
    """
    path = Path(folder) / CURVE_FILE
    try:
        with open(path, "a", encoding="utf-8") as file:
            file.write(_line(point))
    except OSError as error:
        reason = error.strerror or error
        raise OSError(error.errno, f"{path} could not be written ({reason})") from error


def _line(point: dict[str, Any]) -> str:
    return json.dumps(point, allow_nan=False) + "\n"
