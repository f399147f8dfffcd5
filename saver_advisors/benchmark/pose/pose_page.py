"""The measurement of `saver benchmark pose` as a page."""

from __future__ import annotations

from typing import Any, Final

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


def pose_page(figures: dict[str, Any]) -> str:
    """The page.

    :param figures: what the benchmark wrote
    :return: Markdown
    """
    parts = [
        "# Seeing a person: figures",
        "Generated from `results/pose.json` by `python -m reproduction pages`.",
    ]
    if "models" in figures:
        parts += ["## Accuracy", _accuracy(figures["models"]), "## PCK@0.2 by joint"]
        parts += [_by_joint(figures["models"])]
    if "speed" in figures:
        parts += ["## Milliseconds a frame", _speed(figures["speed"]), "## Parsing"]
        parts += [_parsing(figures["parsing"])]
    return "\n\n".join(parts) + "\n"


def _table(columns: list[str], rows: list[list[str]]) -> str:
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _number(value: float | None, digits: int) -> str:
    return "more than half missed" if value is None else f"{value:.{digits}f}"


def _accuracy(models: dict[str, Any]) -> str:
    rows = [
        [
            SETS.get(name, name),
            MODELS.get(model, model),
            str(row["frames"]),
            _number(row["pck_0.2"], 3),
            _number(row["error_px"], 1),
            _number(row["error_mm"], 0),
            _number(row["oks_ap"], 3),
            _number(row["frames_per_second"], 1),
        ]
        for name in SETS
        for model, sets in models.items()
        if (row := sets.get(name)) is not None
    ]
    columns = ["Pictures", "Model", "Number", "PCK@0.2", "Error (px)", "Wrists and hips (mm)"]
    return _table([*columns, "OKS-AP", "Frames/s"], rows)


def _by_joint(models: dict[str, Any]) -> str:
    shown = {model: sets["test"]["pck_0.2_by_joint"] for model, sets in models.items()}
    joints = next(iter(shown.values()))
    rows = [
        [joint.replace("_", " "), *(_number(one[joint], 3) for one in shown.values())]
        for joint in joints
    ]
    return _table(["Joint", *(MODELS.get(model, model) for model in shown)], rows)


def _speed(rows: list[dict[str, Any]]) -> str:
    lines = []
    for row in rows:
        spent = row["milliseconds"]
        sequential = spent["stage1_sequential"] + spent["stage2_sequential"]
        placed = spent.get("network_branches_in_threads")
        exported = spent.get("network_onnxruntime")
        lines.append(
            [
                row["architecture"],
                f"{row['width']} x {row['height']}",
                str(row["threads"]),
                str(row["limbs"]),
                f"{spent['backbone']:.1f}",
                f"{spent['stage1']:.1f}",
                f"{spent['stage2']:.1f}",
                f"{spent['stage1'] + spent['stage2']:.1f}",
                f"{sequential:.1f}",
                "" if placed is None else f"{placed:.1f}",
                f"{spent['network']:.1f}",
                "" if exported is None else f"{exported:.1f}",
            ]
        )
    columns = ["Network", "Picture", "Threads", "Limbs", "Backbone", "Stage 1", "Stage 2"]
    columns += ["Branches as one", "In sequence", "Whole, branches in threads", "Whole"]
    columns += ["Whole, onnxruntime"]
    return _table(columns, lines)


def _parsing(rows: list[dict[str, Any]]) -> str:
    lines = [
        [f"{row['width']} x {row['height']}", str(row["people"]), f"{row['milliseconds']:.2f}"]
        for row in rows
    ]
    return _table(["Picture", "People", "Milliseconds"], lines)
