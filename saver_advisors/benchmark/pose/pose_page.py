"""Write the measurements of `saver benchmark pose` as a page."""

from __future__ import annotations

from typing import Any, Final

from saver_advisors.reporting.tables import markdown, rows_table

SETS: Final = {
    "test": "held-out people and patterns, arms in view",
    "occluded": "arms between camera and person",
    "low_light": "low light",
    "two_people": "two people",
}
MODELS: Final = {
    "saver": "parallel ensemble (light)",
    "saver_mirror": "the same, mirror image too",
    "blazepose_lite": "BlazePose lite",
    "blazepose_full": "BlazePose full",
    "blazepose_heavy": "BlazePose heavy",
}
#: Columns of the table of accuracy: key of the figure, and number of decimals.
_FIGURES: Final = {
    "Number": ("frames", 0),
    "PCK@0.2": ("pck_0.2", 3),
    "Error (px)": ("error_px", 1),
    "Wrists and hips (mm)": ("error_mm", 0),
    "OKS-AP": ("oks_ap", 3),
    "Frames/s": ("frames_per_second", 1),
}
#: Columns of the table of speed: parts of the network whose milliseconds are added.
_PARTS: Final = {
    "Backbone": ("backbone",),
    "Stage 1": ("stage1",),
    "Stage 2": ("stage2",),
    "Branches as one": ("stage1", "stage2"),
    "In sequence": ("stage1_sequential", "stage2_sequential"),
    "Whole, branches in threads": ("network_branches_in_threads",),
    "Whole": ("network",),
    "Whole, onnxruntime": ("network_onnxruntime",),
}
#: Columns of the table of parsing times.
_PARSING: Final = {
    "Picture": "{width} x {height}",
    "People": "{people}",
    "Milliseconds": "{milliseconds:.2f}",
}


def pose_page(figures: dict[str, Any]) -> str:
    """Return the page.

    :param figures: the JSON of the benchmark.
    :return: Markdown.
    """
    parts = [
        "# Seeing a person: figures",
        "Generated from the JSON file of `saver benchmark pose`.",
    ]
    if "models" in figures:
        parts += ["## Accuracy", _accuracy(figures["models"]), "## PCK@0.2 by joint"]
        parts += [_by_joint(figures["models"])]
    if "speed" in figures:
        parts += ["## Milliseconds a frame", _speed(figures["speed"]), "## Parsing"]
        parts += [rows_table(figures["parsing"], _PARSING)]
    return "\n\n".join(part.rstrip("\n") for part in parts) + "\n"


def _number(value: float | None, digits: int) -> str:
    return "more than half missed" if value is None else f"{value:.{digits}f}"


def _accuracy(models: dict[str, Any]) -> str:
    rows = [
        [title, MODELS.get(model, model)]
        + [_number(sets[name][key], digits) for key, digits in _FIGURES.values()]
        for name, title in SETS.items()
        for model, sets in models.items()
        if name in sets
    ]
    return markdown(["Pictures", "Model", *_FIGURES], rows)


def _by_joint(models: dict[str, Any]) -> str:
    shown = {model: sets["test"]["pck_0.2_by_joint"] for model, sets in models.items()}
    rows = [
        [joint.replace("_", " "), *(_number(one[joint], 3) for one in shown.values())]
        for joint in next(iter(shown.values()))
    ]
    return markdown(["Joint", *(MODELS.get(model, model) for model in shown)], rows)


def _speed(rows: list[dict[str, Any]]) -> str:
    lines = []
    for row in rows:
        spent = row["milliseconds"]
        size = f"{row['width']} x {row['height']}"
        line = [row["architecture"], size, str(row["threads"]), str(row["limbs"])]
        for parts in _PARTS.values():
            measured = all(part in spent for part in parts)
            line.append(f"{sum(spent[part] for part in parts):.1f}" if measured else "")
        lines.append(line)
    return markdown(["Network", "Picture", "Threads", "Limbs", *_PARTS], lines)
