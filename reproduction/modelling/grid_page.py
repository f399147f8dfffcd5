"""Render a grid of chapter 7 as a page, next to the paper's Tables 7.4 and 7.5."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from reproduction.findings import verdict_of
from reproduction.modelling.grid import PAPER_EPOCHS
from reproduction.modelling.paper_claims import ADVERSARIAL, paper, paper_cells
from saver_advisors.reporting.tables import markdown, rows_table

_UNIT: Final = {"ik": "rad", "id": "N m"}
_COLUMNS: Final = (*ADVERSARIAL, "mlp")
_PEERS: Final = ("analytic", "conditional", "flow", "identified")

Results = Sequence[Mapping[str, Any]]
Group = dict[tuple[str, int, float], list[Mapping[str, Any]]]


def render(figures: Mapping[str, Any]) -> str:
    """Render the figures as a page.

    :param figures: content of a JSON file of ``ik`` or ``id``.
    :return: Markdown.
    """
    robot, task = figures["robot"], figures["task"]
    groups: Group = defaultdict(list)
    for cell in figures["cells"]:
        weight = cell.get("supervised_weight", 0.0)
        label = cell["model"] + (f" + {weight:g} MSE" if weight else "")
        groups[label, cell["size"], cell["sigma"]].append(cell)
    parts = [f"# {figures['title']}\n", _introduction(robot, task, figures)]
    parts += ["## The paper's claims, evaluated\n", _claims(figures["claims"])]
    if rows := figures.get("little_data"):
        parts += ["## With 10,000 samples\n", _little_data(task, rows)]
    if comparison := _comparison(robot, task, groups):
        parts += ["## Comparison with the paper's table\n", comparison]
    parts += ["## Every cell\n", _cells(task, groups)]
    parts.append(_origin(figures))
    return "\n".join(parts)


def _introduction(robot: str, task: str, figures: Mapping[str, Any]) -> str:
    joints = ""
    if robot == "mico" and task == "ik":
        joints = (
            " Joint 4 of the MICO does not move the hand: *moving* is the error over joints 1 to "
            "3, which the conclusions use; *all* is over all four, as in the paper."
        )
    table = "7.4" if robot == "mico" else "7.5"
    return (
        f"Root mean square errors in {_UNIT[task]} over the joints, on the validation split and "
        f"on the unseen trajectory; {_training(figures)}. Size k stands for the first k x 10,000 "
        f"consecutive samples. Figures over several seeds are means, with their range in brackets. "
        f"The paper's figures (Table {table}) were measured on its arm, ours on the simulated "
        f"twin: compare orders and ratios, not absolute values.{joints}\n"
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


def _claims(claims: Results) -> str:
    def told(who: str) -> Callable[[Mapping[str, Any]], str]:
        return lambda one: f"{verdict_of(one[who]['holds'])}: {one[who]['figures']}"

    return rows_table(
        claims,
        {"the paper's claim": "{claim}", "by its table": told("paper"), "here": told("here")},
    )


def _little_data(task: str, rows: Results) -> str:
    """Compare adversarial models with the MLP, with intervals if there are several seeds."""
    note = (
        f"RMSE on the unseen trajectory minus that of the MLP of the same seed ({_UNIT[task]}): "
        "below 0 the adversarial model is better. Means over seeds, 95% intervals (Student's t). "
        "*MSE weight* is the weight of a squared error added to the adversarial loss.\n"
    )
    table = rows_table(
        sorted(rows, key=lambda one: (one["supervised_weight"], one["difference"])),
        {
            "model": "{model}",
            "sigma": "{sigma:g}",
            "MSE weight": "{supervised_weight:g}",
            "seeds": "{seeds}",
            "minus the MLP": "{difference:+.3f}",
            "95% interval": lambda one: (
                "-" if one["interval"] is None else "[{:+.3f}, {:+.3f}]".format(*one["interval"])
            ),
        },
    )
    return f"{note}\n{table}"


def _comparison(robot: str, task: str, groups: Group) -> str:
    """Arrange validation / test as the paper's table does, ours first and then the paper's."""
    theirs = {
        (cell["model"], cell["size"], cell["sigma"]): cell
        for cell in paper_cells(robot, task)
        if cell["model"] in _COLUMNS
    }
    rows = []
    for size, sigma in sorted({key[1:] for key in groups if key[0] in _COLUMNS}):
        cells = []
        for model in _COLUMNS:
            key = (model, size, sigma)
            text = "-"
            if ours := groups.get(key):
                text = " / ".join(
                    f"{_mean(ours, f'{kind}_rmse'):.3g}" for kind in ("validation", "test")
                )
            if key in theirs:
                text += f" ({theirs[key]['validation']:g} / {theirs[key]['test']:g})"
            cells.append(text)
        rows.append([f"Da{size}-Dev{round(sigma / 0.2)}", *cells])
    if not rows:
        return ""
    note = "Validation / test, the paper's in brackets; the MLP has one cell per size.\n"
    return f"{note}\n{markdown(['', *_COLUMNS], rows)}"


def _cells(task: str, groups: Group) -> str:
    columns: dict[str, Callable[[Results], str]] = {}
    if task == "ik":
        columns = {
            "validation": _spread("validation_rmse_moving"),
            "test, moving": _spread("test_rmse_moving"),
            "test, all": _spread("test_rmse"),
            "hand off, raw (median / p99, mm)": _hand("raw"),
            "refined": _hand("refined"),
        }
    else:
        columns = {"validation": _spread("validation_rmse"), "test": _spread("test_rmse")}
    columns["one prediction (ms)"] = _spread("latency_ms")
    columns["one of 4096 (us)"] = _spread("batch_us")
    columns["training (min of CPU)"] = lambda results: (
        f"{np.mean([one['training_s']['cpu'] for one in results]) / 60:.2f}"
    )
    order = {name: index for index, name in enumerate((*_COLUMNS, *_PEERS))}
    keys = sorted(groups, key=lambda one: (one[1], order[one[0].split()[0]], one[2], one[0]))
    rows = [
        [model, str(size), f"{sigma:g}", str(len(results))]
        + [cell(results) for cell in columns.values()]
        for model, size, sigma in keys
        if (results := groups[model, size, sigma])
    ]
    return markdown(["model", "size", "sigma", "seeds", *columns], rows)


def _mean(results: Results, column: str) -> float:
    return float(np.mean([one[column] for one in results]))


def _spread(column: str) -> Callable[[Results], str]:
    def cell(results: Results) -> str:
        values = [one[column] for one in results]
        mean = f"{np.mean(values):.3g}"
        return mean if len(values) == 1 else f"{mean} [{min(values):.3g}, {max(values):.3g}]"

    return cell


def _hand(kind: str) -> Callable[[Results], str]:
    def cell(results: Results) -> str:
        distances = [one["task_space_mm"][kind] for one in results]
        return f"{_mean(distances, 'median'):.3g} / {_mean(distances, 'p99'):.3g}"

    return cell


def _origin(figures: Mapping[str, Any]) -> str:
    text = (
        f"The paper reports {paper()['prediction_ms']:g} ms per prediction and "
        f"{paper()['training_minutes']} minutes per training run, on a Titan Xp."
    )
    if origin := figures.get("provenance"):
        text += (
            f" Collected {origin['time']} at commit `{origin['commit']}` with "
            f"`{origin['command']}` on {origin['machine']['cpu']}; each cell's file has its own "
            "provenance."
        )
    return text + "\n"
