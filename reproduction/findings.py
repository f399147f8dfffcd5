"""Evaluate the dissertation's findings about advising on training runs.

A finding consists of comparisons between rows of a table. In these runs it holds if every
comparison comes out in its favour by more than the evaluations can resolve. It does not hold if one
comes out against it by as much. It holds so far if rows are missing and every possible comparison
is in its favour. It cannot be told if no comparison is possible or if two rows are too close.

Whether other seeds would show the same is a separate question. It takes at least four seeds per row
and a 95% interval of the difference that excludes 0: with fewer seeds, one of two equal rows lies
wholly above the other by chance in more than one of twenty cases (with four, in 2 of 70).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from saver_advisors.evaluation.metrics import RISEN
from saver_advisors.evaluation.statistics import Estimate, difference, estimate
from saver_advisors.experiments.summary import MethodRow
from saver_advisors.experiments.training_runs import TrainingRun

Metric = Literal["inspired_epoch", "rise_time", "maximum_success_rate", "effective_learning_rate"]
Verdict = Literal["holds", "holds so far", "does not hold", "cannot be told"]
BeyondSeeds = Literal["yes", "no", "too few seeds", "-"]

ABBREVIATIONS: Final[Mapping[Metric, str]] = {
    "inspired_epoch": "IE",
    "rise_time": "RT",
    "maximum_success_rate": "MSR",
    "effective_learning_rate": "ELR",
}
LOWER_IS_BETTER: Final = ("inspired_epoch", "rise_time")

MIN_SEEDS: Final = 4
"""Seeds per row from which on a difference can exceed chance at 95%."""

LEARNED: Final = 0.5
"""Lowest MSR at which the rise time is used; the rise of a run that hardly learns is noise."""


def verdict_of(holds: bool | None) -> Verdict:
    """Put a verdict into words.

    :param holds: whether a claim holds; None if that is open.
    :return: the words.
    """
    verdicts: dict[bool | None, Verdict] = {True: "holds", False: "does not hold"}
    return verdicts.get(holds, "cannot be told")


def beyond_seeds(holds: bool | None, n: int, excludes: bool) -> BeyondSeeds:
    """Tell whether a verdict exceeds the variation between seeds.

    :param holds: whether a claim holds; None if that is open.
    :param n: seeds of the figure that decides it.
    :param excludes: whether the figure's 95% interval excludes the border between both verdicts.
    :return: the words.
    """
    if holds is None:
        return "-"
    if n < MIN_SEEDS:
        return "too few seeds"
    return "yes" if excludes else "no"


Z95: Final = 1.959964
"""Half-width of the central 95% of a normal distribution, in standard deviations."""


@dataclass(frozen=True)
class Measured:
    """One metric of one row.

    :param values: one figure per seed.
    :param resolution: smallest difference that the evaluations can resolve.
    """

    values: Sequence[float]
    resolution: float = 0.0


Table = Callable[[Metric, str], Measured | None]
"""Looks up a metric of a row: None if there is no such row, no values if the row's runs have no
such figure.
"""


@dataclass(frozen=True)
class Comparison:
    """A claim that one row is better than another, and the measured difference.

    :param metric: the compared metric.
    :param better: name of the row that is claimed to be better.
    :param worse: name of the other row.
    :param advantage: how much better the first row is, negative if worse; None if a row is missing.
    :param resolution: smallest difference that the evaluations can resolve.
    """

    metric: Metric
    better: str
    worse: str
    advantage: Estimate | None
    resolution: float = 0.0

    @property
    def holds(self) -> bool | None:
        """Whether the claim holds in these runs; None if a row is missing, or for a tie."""
        if self.advantage is None or abs(self.advantage.value) <= self.resolution:
            return None
        return self.advantage.value > 0

    @property
    def sure(self) -> bool:
        """Whether the difference exceeds the variation between seeds."""
        if self.advantage is None or self.holds is None:
            return False
        return self.advantage.n >= MIN_SEEDS and self.advantage.excludes(0.0)

    def to_mapping(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        advantage = None if self.advantage is None else self.advantage.to_mapping()
        own = {**vars(self), "advantage": advantage}
        return {**own, "holds": self.holds, "sure": self.sure}


@dataclass(frozen=True)
class Claim:
    """A claim of the dissertation about its Table 5.2.

    :param text: the claim in words.
    :param task: ``push`` or ``pick-and-place``.
    :param metric: the metric that it is about.
    :param leaders: rows that are claimed to be better than each of the others.
    :param others: the rows they are compared with.
    :param each: whether the claim is about every leader, or only about the best of them.
    """

    text: str
    task: str
    metric: Metric
    leaders: Sequence[str]
    others: Sequence[str]
    each: bool = False


@dataclass(frozen=True)
class Finding:
    """A claim of the dissertation, evaluated on training runs.

    :param claim: the claim.
    :param comparisons: the comparisons that it consists of.
    :param figures: the metric of every row that it is about.
    :param missing: rows that it is about and that have not been run.
    :param open: whether one of the missing rows could still make it true.
    """

    claim: Claim
    comparisons: Sequence[Comparison]
    figures: Mapping[str, Estimate]
    missing: Sequence[str] = ()
    open: bool = False

    @property
    def verdict(self) -> Verdict:
        """What these runs show."""
        parts = [one.holds for _, one in self._known]
        if False in parts:
            return "cannot be told" if self.open else "does not hold"
        if not parts or None in parts:
            return "cannot be told"
        return "holds" if len(parts) == len(self.comparisons) else "holds so far"

    @property
    def beyond_seeds(self) -> BeyondSeeds:
        """Whether the verdict exceeds the variation between seeds."""
        if self.verdict not in ("holds", "does not hold"):
            return "-"
        # One comparison refutes a claim; all are needed to confirm it.
        wanted = self.verdict == "holds"
        deciding = [one for one in self.comparisons if one.holds is wanted]
        enough = all if wanted else any
        if enough(one.sure for one in deciding):
            return "yes"
        seeds = (known.n for known, one in self._known if one.holds is wanted)
        return "no" if enough(n >= MIN_SEEDS for n in seeds) else "too few seeds"

    @property
    def n(self) -> int:
        """Seeds of the comparison that has the fewest; 0 if no comparison is possible."""
        return min((known.n for known, _ in self._known), default=0)

    @property
    def _known(self) -> list[tuple[Estimate, Comparison]]:
        """The possible comparisons with their advantages."""
        return [(one.advantage, one) for one in self.comparisons if one.advantage is not None]

    def text(self) -> str:
        """Describe the comparison that is least in favour of the claim, with its figures."""
        if not self._known:
            return "no two of its rows can be compared"
        advantage, one = min(self._known, key=lambda known: known[0].value)
        metric = self.claim.metric
        parts = [
            f"{name}: {number(self.figures[name].value, metric)}"
            for name in (one.better, one.worse)
        ]
        gap = number(advantage.value, metric, signed=True)
        if advantage.interval is not None:
            low, high = (number(end, metric, signed=True) for end in advantage.interval)
            gap += f" [{low}, {high}]"
        told = f"{ABBREVIATIONS[metric]} of {parts[0]}, of {parts[1]}; advantage {gap}"
        resolvable = number(one.resolution, metric)
        return f"{told}, resolution {resolvable}" if one.resolution else told

    def to_mapping(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        return {
            "claim": self.claim.text,
            "task": self.claim.task,
            "metric": self.claim.metric,
            "verdict": self.verdict,
            "beyond_seeds": self.beyond_seeds,
            "n": self.n,
            "missing": list(self.missing),
            "figures": {name: figure.to_mapping() for name, figure in self.figures.items()},
            "comparisons": [one.to_mapping() for one in self.comparisons],
        }


def claims(rows: Sequence[str]) -> list[Claim]:
    """List the dissertation's claims about advising (chapter 5), in its order.

    :param rows: names of the rows of Table 5.2.
    :return: the claims.
    """
    advised = [row for row in rows if row != "none"]
    q_filters = [row for row in rows if row.startswith("mc-q ")]
    no_q = [row for row in rows if row not in q_filters]

    def first(text: str, row: str, task: str, metric: Metric) -> Claim:
        return Claim(text, task, metric, [row], [other for other in rows if other != row])

    tasks = ("push", "pick-and-place")
    elr: Metric = "effective_learning_rate"
    msr: Metric = "maximum_success_rate"
    looser = "a looser MC-Q threshold inspires earlier: 0.1 before 0.01"
    return [
        *(Claim("all advice beats none", one, elr, advised, ["none"], each=True) for one in tasks),
        Claim("MC-Q is first by ELR", "push", elr, q_filters, no_q),
        first("MC-ACTABS 0.01 has the highest MSR", "mc-actabs 0.01", "push", msr),
        *(first("MC-ACT 0.01 rises fastest", "mc-act 0.01", one, "rise_time") for one in tasks),
        first("EA has the highest MSR", "early", "pick-and-place", msr),
        *(Claim(looser, one, "inspired_epoch", ["mc-q 0.1"], ["mc-q 0.01"]) for one in tasks),
    ]


def evaluate_claim(claim: Claim, table: Table) -> Finding:
    """Evaluate a claim.

    :param claim: a claim of the dissertation.
    :param table: the runs of its task.
    :return: the finding.
    """
    found = {name: table(claim.metric, name) for name in (*claim.leaders, *claim.others)}
    figures = {name: estimate(one.values) for name, one in found.items() if one and one.values}
    leaders = list(claim.leaders)
    if not claim.each:
        # A claim about a group is about its best row.
        best = min if claim.metric in LOWER_IS_BETTER else max
        known = [name for name in leaders if name in figures]
        leaders = [best(known, key=lambda name: figures[name].value)] if known else leaders[:1]
    # Rows that ran and have no such figure, since they hardly learned, need not be beaten.
    others = [name for name in claim.others if (one := found[name]) is None or one.values]
    comparisons = [
        _compare(claim.metric, leader, other, found) for leader in leaders for other in others
    ]
    missing = [name for name, one in found.items() if one is None]
    still_open = not claim.each and any(name in missing for name in claim.leaders)
    return Finding(claim, comparisons, figures, missing, still_open)


def table_of(rows: Iterable[MethodRow]) -> Table:
    """Make a table that looks metrics up in rows of runs.

    :param rows: rows of one task.
    :return: the table. Rows that hardly learned have no rise time, and rows that never succeeded
        no inspired epoch.
    """
    by_name = {row.name: row for row in rows if row.n}

    def look_up(metric: Metric, name: str) -> Measured | None:
        row = by_name.get(name)
        if row is None:
            return None
        found = [_value_of(metric, run) for run in row.runs]
        values = [value for value, _ in found if value is not None]
        resolution = max(resolution for _, resolution in found)
        return Measured(values if len(values) == len(found) else (), resolution)

    return look_up


def _value_of(metric: Metric, run: TrainingRun) -> tuple[float | None, float]:
    """Return a run's figure and its resolution."""
    figures = run.metrics
    best = figures.maximum_success_rate
    of_success = success_resolution(best, run.episodes)
    if metric == "maximum_success_rate":
        return best, of_success
    if metric == "effective_learning_rate":
        rate = figures.effective_learning_rate
        if rate is None:
            return 0.0, 0.0
        # The rate is 0.9 MSR per epochs until then: the relative errors of a quotient add up.
        share = math.hypot(of_success / best, figures.resolution * rate / (RISEN * best))
        return rate, rate * share
    if metric == "rise_time":
        return figures.rise_time if best >= LEARNED else None, figures.resolution
    return figures.inspired_epoch, figures.resolution


def _compare(
    metric: Metric, better: str, worse: str, found: Mapping[str, Measured | None]
) -> Comparison:
    a, b = found[better], found[worse]
    if not a or not b or not a.values or not b.values:
        return Comparison(metric, better, worse, None)
    values = [np.asarray(a.values), np.asarray(b.values)]
    advantage = difference(*(reversed(values) if metric in LOWER_IS_BETTER else values))
    return Comparison(metric, better, worse, advantage, math.hypot(a.resolution, b.resolution))


def number(value: float, metric: Metric, signed: bool = False) -> str:
    """Format a figure as tables show it.

    :param value: the figure.
    :param metric: its metric.
    :param signed: whether figures that are not negative have a plus.
    :return: the text.
    """
    digits = {"maximum_success_rate": 3, "effective_learning_rate": 4}.get(metric, 0)
    return f"{value:{'+' if signed else ''},.{digits}f}"


def success_resolution(success: float, episodes: int) -> float:
    """Compute the smallest difference between success rates that one evaluation resolves.

    :param success: the rate
    :param episodes: of the evaluation
    :return: half of its 95% interval, for a rate at least half an episode away from 0 and 1
    """
    rate = min(max(success, 0.5 / episodes), 1 - 0.5 / episodes)
    return Z95 * math.sqrt(rate * (1 - rate) / episodes)
