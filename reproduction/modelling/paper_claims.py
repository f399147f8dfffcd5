"""Evaluate the paper's claims about its Tables 7.4 and 7.5, on its cells and on ours.

A claim is a function of a table of RMSEs. The same function evaluates the paper's table and ours.
A claim stays open if cells are missing.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from saver_envs.files import read_json

ADVERSARIAL: Final = ("cgan", "lsgan", "bigan", "dualgan")
ALL_DATA: Final = 6
"""Size of all data."""

_SIMILAR: Final = 0.25
"""Figures are similar if they differ by at most this fraction of the smaller one."""

_MUCH: Final = 0.75
"""A figure is much lower than another if it is below this fraction of it."""


@cache
def paper() -> dict[str, Any]:
    """Read the paper's Tables 7.4 and 7.5 from ``chapter7.json``.

    :return: the file's content.
    """
    return dict(read_json(Path(__file__).with_name("chapter7.json")))


def paper_cells(robot: str, task: str) -> list[dict[str, Any]]:
    """List the cells of the paper's table: size, sigma, model, validation and test RMSE.

    :param robot: name of the arm.
    :param task: "ik" or "id".
    :return: one mapping per cell.
    """
    cells = list(paper()["tables"][robot][task])
    analytic = paper()["analytic"].get(robot, {}).get(task)
    if analytic is not None:
        for size in sorted({cell["size"] for cell in cells}):
            cells.append({"size": size, "sigma": 0.0, "model": "analytic", "test": analytic})
    return cells


class RmseTable:
    """RMSEs by model, size and sigma, each a mean over seeds.

    :param cells: with ``model``, ``size``, ``sigma``, ``test`` and, if known, ``validation``.
    """

    def __init__(self, cells: Iterable[Mapping[str, Any]]) -> None:
        found: dict[tuple[str, int, str], dict[float, list[float]]] = defaultdict(dict)
        for cell, column in product(cells, ("test", "validation")):
            if column in cell:
                by_sigma = found[cell["model"], cell["size"], column]
                by_sigma.setdefault(cell["sigma"], []).append(cell[column])
        self._means = {
            key: {sigma: float(np.mean(values)) for sigma, values in by_sigma.items()}
            for key, by_sigma in found.items()
        }
        self.sizes = sorted({size for _, size, _ in self._means})

    def at(self, model: str, size: int, column: str = "test") -> dict[float, float]:
        """Return a model's RMSE at a size, by sigma.

        :param model: name of the model.
        :param size: number of samples, in tens of thousands.
        :param column: ``test`` or ``validation``.
        :return: the means over seeds.
        :raises KeyError: if there are none.
        """
        return self._means[model, size, column]

    def best(self, model: str, size: int, column: str = "test") -> float:
        """Return a model's lowest RMSE at a size, over sigma; arguments as for :meth:`at`.

        :raises KeyError: if there are none.
        """
        return min(self.at(model, size, column).values())

    def both(self, size: int, column: str = "test") -> tuple[float, float]:
        """Return the lowest RMSE of the adversarial models and that of the MLP at a size.

        :raises KeyError: if there are none.
        """
        known = [model for model in ADVERSARIAL if (model, size, column) in self._means]
        if not known:
            raise KeyError(ADVERSARIAL)
        gan = min(self.best(model, size, column) for model in known)
        return gan, self.best("mlp", size, column)


Evaluated = tuple[bool, str]
Rule = Callable[[RmseTable], Evaluated]


def _little_data(table: RmseTable) -> Evaluated:
    gan, mlp = table.both(1)
    return gan < mlp, f"best GAN {gan:.3g}, MLP {mlp:.3g}"


def _advantage_shrinks(table: RmseTable) -> Evaluated:
    first, last = (mlp - gan for gan, mlp in (table.both(1), table.both(ALL_DATA)))
    return first > last, f"MLP less best GAN: {first:+.3g} at size 1, {last:+.3g} at the largest"


def _similar_at_the_end(table: RmseTable) -> Evaluated:
    gan, mlp = table.both(ALL_DATA)
    return abs(gan - mlp) <= _SIMILAR * min(gan, mlp), f"best GAN {gan:.3g}, MLP {mlp:.3g}"


def _base_overfits(table: RmseTable) -> Evaluated:
    found = [table.both(size, "validation") for size in table.sizes]
    lower = sum(mlp < _MUCH * gan for gan, mlp in found)
    return lower == len(found), f"at {lower} of {len(found)} sizes below {_MUCH:.0%} of any GAN's"


def _base_wins(table: RmseTable) -> Evaluated:
    gan, mlp = table.both(ALL_DATA)
    return mlp < gan, f"MLP {mlp:.3g}, best GAN {gan:.3g}"


def _analytic_worst(table: RmseTable) -> Evaluated:
    analytic = table.best("analytic", ALL_DATA)
    worst = max(table.best(model, ALL_DATA) for model in (*ADVERSARIAL, "mlp"))
    return analytic > worst, f"analytic {analytic:.3g}, worst network at its best sigma {worst:.3g}"


def _dualgan_best(table: RmseTable) -> Evaluated:
    figures = {model: table.best(model, ALL_DATA) for model in ADVERSARIAL}
    best = min(figures, key=lambda model: figures[model])
    return best == "dualgan", f"{best} {figures[best]:.3g}, dualgan {figures['dualgan']:.3g}"


def _most_gan_cells_beat_base(table: RmseTable) -> Evaluated:
    better = [
        value < table.best("mlp", size)
        for size, model in product(table.sizes, ADVERSARIAL)
        for value in table.at(model, size).values()
    ]
    return sum(better) > 0.5 * len(better), f"{sum(better)} of {len(better)} cells"


def _middle_sigma_best(table: RmseTable) -> Evaluated:
    middle = []
    for size, model in product(table.sizes, ADVERSARIAL):
        figures = table.at(model, size)
        if len(figures) < 3:
            raise KeyError(model)
        best = min(figures, key=lambda sigma: figures[sigma])
        middle.append(best not in (min(figures), max(figures)))
    told = f"{sum(middle)} of {len(middle)} (model, size)"
    return sum(middle) > 0.5 * len(middle), f"a sigma between the ends is best in {told}"


TEXTS: Final[Mapping[Rule, str]] = {
    _little_data: "With 10,000 samples the best GAN beats the MLP on the unseen trajectory",
    _base_overfits: "The MLP's validation error is much lower than any GAN's",
    _similar_at_the_end: "With all data GANs and MLP are similar",
    _analytic_worst: "The analytic model is the worst",
    _advantage_shrinks: "The GANs' advantage shrinks as data grow",
    _base_wins: "With all data the MLP is better than every GAN",
    _dualgan_best: "DualGAN is the best of the GANs",
    _most_gan_cells_beat_base: "Most GAN cells beat the MLP on the unseen trajectory",
    _middle_sigma_best: "A sigma between 0 and 0.6 is best",
}
CLAIMS: Final[Mapping[tuple[str, str], tuple[Rule, ...]]] = {
    ("mico", "ik"): (_little_data, _advantage_shrinks, _similar_at_the_end, _base_overfits),
    ("mico", "id"): (_base_wins, _analytic_worst, _base_overfits),
    ("fetch", "ik"): (_dualgan_best, _similar_at_the_end, _base_overfits),
    ("fetch", "id"): (
        _little_data,
        _most_gan_cells_beat_base,
        _middle_sigma_best,
        _analytic_worst,
        _base_overfits,
    ),
}


def claims(robot: str, task: str, results: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Evaluate the paper's claims on its own table and on ours.

    Ours uses the joints that move the hand. The claim that a GAN wins with little data stays open
    unless some GAN's interval over seeds excludes the MLP, since a mean of a few seeds may be
    chance.

    :param robot: name of the arm.
    :param task: "ik" or "id".
    :param results: results of cells.
    :return: for each claim ``claim``, and ``holds`` (None: open) and ``figures`` of either table.
    """
    results = list(results)
    ours = RmseTable(
        {
            **{name: one[name] for name in ("model", "size", "sigma")},
            **{kind: one[_column(task, kind)] for kind in ("test", "validation")},
        }
        for one in results
        if not one.get("supervised_weight")
    )
    theirs = RmseTable(paper_cells(robot, task))
    beyond_seeds = any(
        row["supervised_weight"] == 0 and row["interval"] is not None and row["interval"][1] < 0
        for row in little_data(task, results)
    )
    found = []
    for rule in CLAIMS[robot, task]:
        here = _evaluated(rule, ours)
        if rule is _little_data and here["holds"] and not beyond_seeds:
            here["holds"] = None
            here["figures"] += "; no GAN's 95% interval leaves the MLP out"
        found.append({"claim": TEXTS[rule], "paper": _evaluated(rule, theirs), "here": here})
    return found


def little_data(task: str, results: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Compare adversarial models with the MLP on the unseen trajectory, with 10,000 samples.

    :param task: "ik" or "id".
    :param results: results of cells.
    :return: for each (model, sigma, supervised weight) the mean over seeds of its RMSE minus that
        of the MLP of the same seed, the number of ``seeds``, and for at least two of them the 95%
        ``interval`` of Student's t.
    """
    column = _column(task, "test")
    few = [one for one in results if one["size"] == 1]
    base = {one["seed"]: one[column] for one in few if one["model"] == "mlp"}
    groups: dict[tuple[str, float, float], list[float]] = defaultdict(list)
    for one in few:
        if one["model"] in ADVERSARIAL and one["seed"] in base:
            key = one["model"], one["sigma"], float(one.get("supervised_weight", 0.0))
            groups[key].append(one[column] - base[one["seed"]])
    return [
        {
            "model": model,
            "sigma": sigma,
            "supervised_weight": weight,
            "seeds": len(less),
            "difference": float(np.mean(less)),
            "interval": _interval(np.array(less)),
        }
        for (model, sigma, weight), less in groups.items()
    ]


def _interval(values: NDArray[np.float64]) -> list[float] | None:
    """Compute the 95% interval of a mean; None for a single value."""
    if values.size < 2:
        return None
    from scipy.stats import t as student

    half = student.ppf(0.975, values.size - 1) * values.std(ddof=1) / np.sqrt(values.size)
    return [float(values.mean() - half), float(values.mean() + half)]


def _column(task: str, kind: str) -> str:
    return f"{kind}_rmse_moving" if task == "ik" else f"{kind}_rmse"


def _evaluated(rule: Rule, table: RmseTable) -> dict[str, Any]:
    if table.sizes:
        with suppress(KeyError):
            holds, figures = rule(table)
            return {"holds": bool(holds), "figures": figures}
    return {"holds": None, "figures": "cells are missing"}
