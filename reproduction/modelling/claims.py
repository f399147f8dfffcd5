"""What the paper says of its Tables 7.4 and 7.5, and whether the cells measured here say the same.

A claim is a function of (size, model) -> figures; the same function reads the paper's table and
ours, so that both are judged alike. Where cells are missing, a claim is left open.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from importlib import resources
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

ADVERSARIAL: Final = ("cgan", "lsgan", "bigan", "dualgan")
_SIMILAR: Final = 0.25
"""Figures count as similar within this share of the smaller."""

_MUCH: Final = 0.75
"""And as much lower below this share."""


class Missing(Exception):
    """A claim needs cells that there are not."""


@cache
def paper() -> dict[str, Any]:
    """The paper's Tables 7.4 and 7.5, as ``chapter7.json`` has them."""
    file = resources.files(__package__) / "chapter7.json"
    return dict(json.loads(file.read_text(encoding="utf-8")))


def paper_cells(robot: str, task: str) -> list[dict[str, Any]]:
    """The cells of the paper's table: size, sigma, model, validation and test RMSE.

    :param robot: the arm's name
    :param task: "ik" or "id"
    """
    cells = list(paper()["tables"][robot][task])
    analytic = paper()["analytic"].get(robot, {}).get(task)
    if analytic is not None:
        sizes = sorted({cell["size"] for cell in cells})
        cells += [
            {"size": size, "sigma": 0.0, "model": "analytic", "test": analytic} for size in sizes
        ]
    return cells


class Table:
    """Figures by model, size and sigma, each a mean over its seeds.

    :param cells: with ``model``, ``size``, ``sigma``, ``test`` and, where known, ``validation``
    """

    def __init__(self, cells: Iterable[Mapping[str, Any]]) -> None:
        groups: dict[tuple[str, int, float], list[Mapping[str, Any]]] = defaultdict(list)
        for cell in cells:
            groups[cell["model"], cell["size"], cell["sigma"]].append(cell)
        self._groups = groups
        self.sizes = sorted({size for _, size, _ in groups})

    def _mean(self, key: tuple[str, int, float], column: str) -> float:
        values = [cell[column] for cell in self._groups[key] if column in cell]
        if not values:
            raise Missing
        return float(np.mean(values))

    def at(self, model: str, size: int, column: str = "test") -> dict[float, float]:
        """A model's figures at a size, by sigma.

        :raises Missing: where there are none
        """
        keys = [key for key in self._groups if key[:2] == (model, size)]
        if not keys:
            raise Missing
        return {key[2]: self._mean(key, column) for key in keys}

    def best(self, model: str, size: int, column: str = "test") -> float:
        """A model's best figure at a size, over sigma.

        :raises Missing: where there are none
        """
        return min(self.at(model, size, column).values())

    def best_adversarial(self, size: int, column: str = "test") -> float:
        """The best figure of any adversarial model at a size.

        :raises Missing: where there are none
        """
        found = []
        for model in ADVERSARIAL:
            try:
                found.append(self.best(model, size, column))
            except Missing:
                continue
        if not found:
            raise Missing
        return min(found)


Judged = tuple[bool, str]
Rule = Callable[[Table], Judged]


def _little_data(table: Table) -> Judged:
    ours, base = table.best_adversarial(1), table.best("mlp", 1)
    return ours < base, f"best GAN {ours:.3g}, MLP {base:.3g}"


def _advantage_shrinks(table: Table) -> Judged:
    gaps = {
        size: table.best("mlp", size) - table.best_adversarial(size)
        for size in (1, _largest(table))
    }
    first, last = gaps.values()
    return first > last, f"MLP less best GAN: {first:+.3g} at size 1, {last:+.3g} at the largest"


def _similar_at_the_end(table: Table) -> Judged:
    size = _largest(table)
    ours, base = table.best_adversarial(size), table.best("mlp", size)
    return abs(ours - base) <= _SIMILAR * min(ours, base), f"best GAN {ours:.3g}, MLP {base:.3g}"


def _base_overfits(table: Table) -> Judged:
    found = []
    for size in table.sizes:
        base = table.best("mlp", size, "validation")
        found.append((base, table.best_adversarial(size, "validation")))
    if not found:
        raise Missing
    lower = sum(base < _MUCH * ours for base, ours in found)
    return lower == len(found), f"at {lower} of {len(found)} sizes below {_MUCH:.0%} of any GAN's"


def _base_wins(table: Table) -> Judged:
    size = _largest(table)
    ours, base = table.best_adversarial(size), table.best("mlp", size)
    return base < ours, f"MLP {base:.3g}, best GAN {ours:.3g}"


def _analytic_worst(table: Table) -> Judged:
    size = _largest(table)
    analytic = table.best("analytic", size)
    worst = max([table.best(model, size) for model in (*ADVERSARIAL, "mlp")])
    return analytic > worst, f"analytic {analytic:.3g}, worst network at its best sigma {worst:.3g}"


def _dualgan_best(table: Table) -> Judged:
    size = _largest(table)
    figures = {model: table.best(model, size) for model in ADVERSARIAL}
    best = min(figures, key=lambda model: figures[model])
    return best == "dualgan", f"{best} {figures[best]:.3g}, dualgan {figures['dualgan']:.3g}"


def _most_gan_cells_beat_base(table: Table) -> Judged:
    won = total = 0
    for size in table.sizes:
        base = table.best("mlp", size)
        for model in ADVERSARIAL:
            for value in table.at(model, size).values():
                total += 1
                won += value < base
    if not total:
        raise Missing
    return won > 0.5 * total, f"{won} of {total} cells"


def _middle_sigma_best(table: Table) -> Judged:
    won = total = 0
    for size in table.sizes:
        for model in ADVERSARIAL:
            figures = table.at(model, size)
            if len(figures) < 3:
                raise Missing
            best = min(figures, key=lambda sigma: figures[sigma])
            total += 1
            won += best not in (min(figures), max(figures))
    if not total:
        raise Missing
    return won > 0.5 * total, f"a sigma between the ends is best in {won} of {total} (model, size)"


def _largest(table: Table) -> int:
    if not table.sizes or table.sizes[-1] != 6:
        raise Missing
    return table.sizes[-1]


_LITTLE: Final = (
    "With 10,000 samples the best GAN beats the MLP on the unseen trajectory",
    _little_data,
)
_OVERFIT: Final = ("The MLP's validation error is much lower than any GAN's", _base_overfits)
_WORST: Final = ("The analytic model is the worst", _analytic_worst)
CLAIMS: Final[Mapping[tuple[str, str], tuple[tuple[str, Rule], ...]]] = {
    ("mico", "ik"): (
        _LITTLE,
        ("The GANs' advantage shrinks as data grow", _advantage_shrinks),
        ("With all data GANs and MLP are similar", _similar_at_the_end),
        _OVERFIT,
    ),
    ("mico", "id"): (
        ("With all data the MLP is better than every GAN", _base_wins),
        _WORST,
        _OVERFIT,
    ),
    ("fetch", "ik"): (
        ("DualGAN is the best of the GANs", _dualgan_best),
        ("With all data GANs and MLP are similar", _similar_at_the_end),
        _OVERFIT,
    ),
    ("fetch", "id"): (
        _LITTLE,
        ("Most GAN cells beat the MLP on the unseen trajectory", _most_gan_cells_beat_base),
        ("A sigma between 0 and 0.6 is best", _middle_sigma_best),
        _WORST,
        _OVERFIT,
    ),
}


def claims(robot: str, task: str, results: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Judge the paper's claims by its own table and by ours.

    Ours goes by the joints that move the hand. That a GAN wins with little data is open while no
    GAN's interval over seeds leaves the MLP out: a mean alone may be the chance of a few seeds.

    :param robot: the arm's name
    :param task: "ik" or "id"
    :param results: of cells
    :return: for each claim ``claim``, and ``holds`` (None: open) and ``figures`` of either table
    """
    results = list(results)
    ours = Table(
        {
            "model": one["model"],
            "size": one["size"],
            "sigma": one["sigma"],
            "test": one[_column(task, "test")],
            "validation": one[_column(task, "validation")],
        }
        for one in results
        if not one.get("supervised_weight")
    )
    theirs = Table(paper_cells(robot, task))
    judged: list[dict[str, Any]] = [
        {"claim": claim, "paper": _judged(rule, theirs), "here": _judged(rule, ours)}
        for claim, rule in CLAIMS[robot, task]
    ]
    for one in judged:
        here = one["here"]
        if one["claim"] == _LITTLE[0] and here["holds"] and not _beyond_seeds(task, results):
            here["holds"] = None
            here["figures"] += "; no GAN's 95% interval leaves the MLP out"
    return judged


def _beyond_seeds(task: str, results: Sequence[Mapping[str, Any]]) -> bool:
    """Whether any GAN without a squared error is better than the MLP by more than seeds differ."""
    return any(
        row["supervised_weight"] == 0 and row["interval"] is not None and row["interval"][1] < 0
        for row in little_data(task, results)
    )


def little_data(task: str, results: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Adversarial models less the MLP on the unseen trajectory, with 10,000 samples.

    :param task: "ik" or "id"
    :param results: of cells
    :return: for each (model, sigma, supervised weight) the mean over seeds of its RMSE less that
        of the MLP of the same seed, the number of ``seeds``, and with at least two of them the 95%
        ``interval`` of Student's t
    """
    column = _column(task, "test")
    base: dict[int, float] = {}
    groups: dict[tuple[str, float, float], dict[int, float]] = defaultdict(dict)
    for one in results:
        if one["size"] != 1:
            continue
        if one["model"] == "mlp":
            base[one["seed"]] = one[column]
        elif one["model"] in ADVERSARIAL:
            key = one["model"], one["sigma"], float(one.get("supervised_weight", 0.0))
            groups[key][one["seed"]] = one[column]
    found = []
    for (model, sigma, weight), values in groups.items():
        less = np.array([value - base[seed] for seed, value in values.items() if seed in base])
        if less.size:
            found.append(
                {
                    "model": model,
                    "sigma": sigma,
                    "supervised_weight": weight,
                    "seeds": int(less.size),
                    "difference": float(less.mean()),
                    "interval": _interval(less),
                }
            )
    return found


def _interval(values: NDArray[np.float64]) -> list[float] | None:
    """The 95% interval of a mean; None for one value."""
    if values.size < 2:
        return None
    from scipy.stats import t as student

    half = student.ppf(0.975, values.size - 1) * values.std(ddof=1) / np.sqrt(values.size)
    return [float(values.mean() - half), float(values.mean() + half)]


def _column(task: str, kind: str) -> str:
    return f"{kind}_rmse_moving" if task == "ik" else f"{kind}_rmse"


def _judged(rule: Rule, table: Table) -> dict[str, Any]:
    try:
        holds, figures = rule(table)
    except Missing:
        return {"holds": None, "figures": "cells are missing"}
    return {"holds": bool(holds), "figures": figures}
