"""The counterparts of Tables 7.4 and 7.5 as a page of Markdown, the paper's figures beside ours."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from reproduction.modelling.cells import PAPER_EPOCHS
from reproduction.modelling.claims import ADVERSARIAL, paper, paper_cells
from saver_advisors.reporting.tables import markdown

_UNIT: Final = {"ik": "rad", "id": "N m"}
_COLUMNS: Final = (*ADVERSARIAL, "mlp")
_PEERS: Final = ("analytic", "conditional", "flow", "identified")

Group = dict[tuple[str, int, float], list[Mapping[str, Any]]]


def render(figures: Mapping[str, Any]) -> str:
    """The figures as a page.

    :param figures: content of a JSON file of ``ik`` or ``id``
    :return: Markdown
    """
    robot, task = figures["robot"], figures["task"]
    groups: Group = defaultdict(list)
    for cell in figures["cells"]:
        weight = cell.get("supervised_weight", 0.0)
        label = cell["model"] + (f" + {weight:g} MSE" if weight else "")
        groups[label, cell["size"], cell["sigma"]].append(cell)
    parts = [f"# {figures['title']}\n", _introduction(robot, task, figures)]
    parts += ["## What the paper says, and what is found here\n", _claims(figures["claims"])]
    if rows := figures.get("little_data"):
        parts += ["## With 10,000 samples\n", _little_data(task, rows)]
    if comparison := _comparison(robot, task, groups):
        parts += ["## Beside the paper's table\n", comparison]
    parts += ["## Every cell\n", _cells(task, groups)]
    parts.append(_origin(figures))
    return "\n".join(part for part in parts if part)


def _introduction(robot: str, task: str, figures: Mapping[str, Any]) -> str:
    joints = ""
    if robot == "mico" and task == "ik":
        joints = (
            " Joint 4 of the MICO does not move the hand: *moving* is over joints 1 to 3, and "
            "what is concluded goes by it; *all* is over all four, as in the paper."
        )
    table = "7.4" if robot == "mico" else "7.5"
    return (
        f"Root mean square errors in {_UNIT[task]}, over the joints, on the validation share and "
        f"on the unseen trajectory; {_training(figures)}. Of size k are the first k x 10,000 "
        f"consecutive samples. Several seeds give the mean and, in brackets, their range. The "
        f"paper's figures (Table {table}) were measured on its arm, ours on the simulated twin: "
        f"orders and ratios compare, not sizes.{joints}\n"
    )


def _training(figures: Mapping[str, Any]) -> str:
    """How long, in what precision and on what."""
    epochs = int(figures["epochs"])
    text = (
        f"{epochs} epochs"
        if epochs == PAPER_EPOCHS
        else f"{epochs} of the paper's {PAPER_EPOCHS} epochs"
    )
    cells = figures["cells"]
    halved = [cell for cell in cells if cell.get("precision") == "bfloat16"]
    if halved:
        text += (
            f", products between hidden layers in bfloat16 while training{_share(halved, cells)}"
        )
    on_gpu = [cell for cell in cells if cell.get("device") == "cuda"]
    if on_gpu:
        gpus = {cell["provenance"]["machine"]["gpu"] for cell in on_gpu}
        text += f", on a GPU ({', '.join(sorted(gpus))}){_share(on_gpu, cells)}"
    return text


def _share(some: Sequence[object], cells: Sequence[object]) -> str:
    return "" if len(some) == len(cells) else f" in {len(some)} of {len(cells)} cells"


def _claims(claims: Sequence[Mapping[str, Any]]) -> str:
    rows = [
        [one["claim"], *(f"{_word(one[who])}: {one[who]['figures']}" for who in ("paper", "here"))]
        for one in claims
    ]
    return markdown(["the paper's claim", "by its table", "here"], rows)


def _little_data(task: str, rows: Sequence[Mapping[str, Any]]) -> str:
    """Adversarial models beside the MLP, with intervals where there are seeds."""
    note = (
        f"RMSE on the unseen trajectory less that of the MLP of the same seed ({_UNIT[task]}): "
        "below 0 the adversarial model is better. Means over seeds, 95% intervals (Student's t). "
        "*MSE weight* is that of a squared error beside the adversarial loss.\n"
    )
    cells = [
        [
            one["model"],
            f"{one['sigma']:g}",
            f"{one['supervised_weight']:g}",
            str(one["seeds"]),
            f"{one['difference']:+.3f}",
            "-" if one["interval"] is None else "[{:+.3f}, {:+.3f}]".format(*one["interval"]),
        ]
        for one in sorted(rows, key=lambda one: (one["supervised_weight"], one["difference"]))
    ]
    columns = ["model", "sigma", "MSE weight", "seeds", "less the MLP", "95% interval"]
    return f"{note}\n{markdown(columns, cells)}"


def _word(judged: Mapping[str, Any]) -> str:
    return {True: "holds", False: "does not hold", None: "open"}[judged["holds"]]


def _comparison(robot: str, task: str, groups: Group) -> str:
    """Rows as the paper's; in each cell validation / test, ours and then the paper's."""
    theirs = {
        (cell["model"], cell["size"], cell["sigma"]): cell
        for cell in paper_cells(robot, task)
        if cell["model"] in _COLUMNS
    }
    keys = sorted({key[1:] for key in groups if key[0] in _COLUMNS})
    rows = []
    for size, sigma in keys:
        cells = []
        for model in _COLUMNS:
            key = (model, size, sigma)
            ours = groups.get(key)
            text = _both(ours, "") if ours else "-"
            if key in theirs:
                text += f" ({theirs[key]['validation']:g} / {theirs[key]['test']:g})"
            cells.append(text)
        rows.append([f"Da{size}-Dev{round(sigma / 0.2)}", *cells])
    if not rows:
        return ""
    note = "Validation / test, the paper's in brackets; the MLP has one cell a size.\n"
    return f"{note}\n{markdown(['', *_COLUMNS], rows)}"


def _both(results: Sequence[Mapping[str, Any]], suffix: str) -> str:
    mean = [
        float(np.mean([one[f"{kind}_rmse{suffix}"] for one in results]))
        for kind in ("validation", "test")
    ]
    return f"{mean[0]:.3g} / {mean[1]:.3g}"


def _cells(task: str, groups: Group) -> str:
    columns = ["model", "size", "sigma", "seeds", "validation"]
    columns += ["test, moving", "test, all"] if task == "ik" else ["test"]
    if task == "ik":
        columns += ["hand off, raw (median / p99, mm)", "refined"]
    columns += ["one prediction (ms)", "one of 4096 (us)", "training (min of CPU)"]
    order = {name: index for index, name in enumerate((*_COLUMNS, *_PEERS))}
    rows = []
    for key in sorted(groups, key=lambda one: (one[1], order[one[0].split()[0]], one[2], one[0])):
        results = groups[key]
        suffix = "_moving" if task == "ik" else ""
        row = [key[0], str(key[1]), f"{key[2]:g}", str(len(results))]
        row += [
            _spread(results, f"validation_rmse{suffix}"),
            _spread(results, f"test_rmse{suffix}"),
        ]
        if task == "ik":
            row += [_spread(results, "test_rmse"), _hand(results, "raw"), _hand(results, "refined")]
        row += [_spread(results, "latency_ms"), _spread(results, "batch_us")]
        row.append(f"{np.mean([one['training_s']['cpu'] for one in results]) / 60:.2f}")
        rows.append(row)
    return markdown(columns, rows)


def _spread(results: Sequence[Mapping[str, Any]], column: str) -> str:
    values = [one[column] for one in results]
    mean = f"{np.mean(values):.3g}"
    return mean if len(values) == 1 else f"{mean} [{min(values):.3g}, {max(values):.3g}]"


def _hand(results: Sequence[Mapping[str, Any]], kind: str) -> str:
    median = np.mean([one["task_space_mm"][kind]["median"] for one in results])
    p99 = np.mean([one["task_space_mm"][kind]["p99"] for one in results])
    return f"{median:.3g} / {p99:.3g}"


def _origin(figures: Mapping[str, Any]) -> str:
    lines = [
        f"The paper took {paper()['prediction_ms']:g} ms for a prediction and "
        f"{paper()['training_minutes']} minutes for a training run, on a Titan Xp."
    ]
    origin = figures.get("provenance")
    if origin:
        lines.append(
            f"Collected {origin['time']} at commit `{origin['commit']}` with "
            f"`{origin['command']}` on {origin['machine']['cpu']}; each cell's own file says where "
            "it comes from."
        )
    return " ".join(lines) + "\n"
