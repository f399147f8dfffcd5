"""Render a grid of chapter 7 as a page, next to the paper's Tables 7.4 and 7.5."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from reproduction.findings import verdict_of
from reproduction.modelling.grid import PAPER_EPOCHS
from reproduction.modelling.paper_claims import ADVERSARIAL, paper, paper_cells
from reproduction.page_templates import page
from saver_advisors.reporting.tables import Column, markdown

_UNIT: Final = {"ik": "rad", "id": "N m"}
_MODELS: Final = (*ADVERSARIAL, "mlp")
_PEERS: Final = ("analytic", "conditional", "flow", "identified")
_LITTLE_DATA: Final[Mapping[str, Column]] = {
    "model": "{model}",
    "sigma": "{sigma:g}",
    "MSE weight": "{supervised_weight:g}",
    "seeds": "{seeds}",
    "minus the MLP": "{difference:+.3f}",
    "95% interval": lambda one: (
        "-" if one["interval"] is None else "[{:+.3f}, {:+.3f}]".format(*one["interval"])
    ),
}

Results = Sequence[Mapping[str, Any]]
Key = tuple[str, int, float]
"""Model, size and sigma of cells that differ in their seeds."""


def render(figures: Mapping[str, Any]) -> str:
    """Render the figures as a page.

    :param figures: content of a JSON file of ``ik`` or ``id``.
    :return: Markdown.
    """
    task = figures["task"]
    groups: dict[Key, list[Mapping[str, Any]]] = defaultdict(list)
    for cell in figures["cells"]:
        weight = cell.get("supervised_weight", 0.0)
        label = cell["model"] + (f" + {weight:g} MSE" if weight else "")
        groups[label, cell["size"], cell["sigma"]].append(cell)
    order = {name: index for index, name in enumerate((*_MODELS, *_PEERS))}
    keys = sorted(groups, key=lambda one: (one[1], order[one[0].split()[0]], one[2], one[0]))
    return page(
        "modelling",
        unit=_UNIT[task],
        training=_training(figures),
        comparison=_comparison(figures["robot"], task, groups),
        groups=[
            {"model": key[0], "size": key[1], "sigma": key[2], "results": groups[key]}
            for key in keys
        ],
        paper=paper(),
        of_claims={
            "the paper's claim": "{claim}",
            "by its table": _evaluated("paper"),
            "here": _evaluated("here"),
        },
        of_little_data=_LITTLE_DATA,
        of_groups=_columns(task),
        **{"little_data": [], "provenance": None, **figures},
    )


def _training(figures: Mapping[str, Any]) -> str:
    """Describe the length of training, its precision and its device."""
    epochs, cells = int(figures["epochs"]), figures["cells"]
    paper_length = "" if epochs == PAPER_EPOCHS else f" of the paper's {PAPER_EPOCHS}"
    text = f"{epochs}{paper_length} epochs"

    def some(those: Results) -> str:
        return "" if len(those) == len(cells) else f" in {len(those)} of {len(cells)} cells"

    if halved := [cell for cell in cells if cell.get("precision") == "bfloat16"]:
        text += f", products between hidden layers in bfloat16 while training{some(halved)}"
    if on_gpu := [cell for cell in cells if cell.get("device") == "cuda"]:
        gpus = {cell["provenance"]["machine"]["gpu"] for cell in on_gpu}
        text += f", on a GPU ({', '.join(sorted(gpus))}){some(on_gpu)}"
    return text


def _evaluated(table: str) -> Column:
    return lambda one: f"{verdict_of(one[table]['holds'])}: {one[table]['figures']}"


def _comparison(robot: str, task: str, groups: Mapping[Key, Results]) -> str:
    """Arrange validation / test as the paper's table does, ours first and then the paper's."""
    theirs = {(one["model"], one["size"], one["sigma"]): one for one in paper_cells(robot, task)}

    def cell(key: Key) -> str:
        text = "-"
        if ours := groups.get(key):
            text = " / ".join(
                f"{_mean(ours, f'{kind}_rmse'):.3g}" for kind in ("validation", "test")
            )
        if key in theirs:
            text += f" ({theirs[key]['validation']:g} / {theirs[key]['test']:g})"
        return text

    rows = [
        [f"Da{size}-Dev{round(sigma / 0.2)}", *(cell((model, size, sigma)) for model in _MODELS)]
        for size, sigma in sorted({key[1:] for key in groups if key[0] in _MODELS})
    ]
    return markdown(["", *_MODELS], rows) if rows else ""


def _columns(task: str) -> dict[str, Column]:
    """Return the columns of the table of all cells."""
    errors = {"validation": _spread("validation_rmse"), "test": _spread("test_rmse")}
    if task == "ik":
        errors = {
            "validation": _spread("validation_rmse_moving"),
            "test, moving": _spread("test_rmse_moving"),
            "test, all": _spread("test_rmse"),
            "hand off, raw (median / p99, mm)": _hand("raw"),
            "refined": _hand("refined"),
        }
    return {
        "model": "{model}",
        "size": "{size}",
        "sigma": "{sigma:g}",
        "seeds": lambda row: str(len(row["results"])),
        **errors,
        "one prediction (ms)": _spread("latency_ms"),
        "one of 4096 (us)": _spread("batch_us"),
        "training (min of CPU)": lambda row: (
            f"{_mean([one['training_s'] for one in row['results']], 'cpu') / 60:.2f}"
        ),
    }


def _mean(results: Results, column: str) -> float:
    return float(np.mean([one[column] for one in results]))


def _spread(column: str) -> Column:
    def cell(row: Mapping[str, Any]) -> str:
        values = [one[column] for one in row["results"]]
        mean = f"{np.mean(values):.3g}"
        return mean if len(values) == 1 else f"{mean} [{min(values):.3g}, {max(values):.3g}]"

    return cell


def _hand(kind: str) -> Column:
    def cell(row: Mapping[str, Any]) -> str:
        distances = [one["task_space_mm"][kind] for one in row["results"]]
        return f"{_mean(distances, 'median'):.3g} / {_mean(distances, 'p99'):.3g}"

    return cell
