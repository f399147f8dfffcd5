"""The dissertation's findings about advising, each put to the test of a table of runs.

A finding comes down to comparisons between rows. In the runs at hand it holds where every
comparison comes out so by more than the evaluations can resolve; it does not hold where one comes
out the other way by as much; it holds so far where rows are missing and every comparison that can
be made comes out so; and it cannot be told where none can be made or two rows are too close.
Whether other seeds would show the same is another question, and told apart: that takes four seeds a
row, since of two rows that do not differ, with fewer seeds, one lies wholly above the other by
chance in more than one of twenty cases (with four in 2 of 70), and a 95% interval of the difference
that leaves out 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from saver_advisors.evaluation.metrics import RISEN
from saver_advisors.evaluation.statistics import Estimate, difference, estimate
from saver_advisors.experiments.summary import MethodRow, success_resolution
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
"""Seeds a row from which on a difference can be more than chance at 95%."""

LEARNED: Final = 0.5
"""MSR from which on a row has a rise to speak of: that of a run that hardly learns is noise."""


@dataclass(frozen=True)
class Measured:
    """One metric of one row.

    :param values: a figure a seed
    :param resolution: how finely its evaluations tell it apart from another's
    """

    values: Sequence[float]
    resolution: float = 0.0


Table = Callable[[Metric, str], Measured | None]
"""Looks up a metric of a row: None where there is no such row, no values where it ran and has no
such figure.
"""


@dataclass(frozen=True)
class Comparison:
    """Whether one row is better than another.

    :param metric: what is compared
    :param better: the row that is said to be better
    :param worse: the other
    :param advantage: how much better it is; below 0 where it is worse. None where a row is missing
    :param resolution: what the evaluations can tell apart
    """

    metric: Metric
    better: str
    worse: str
    advantage: Estimate | None
    resolution: float = 0.0

    @property
    def holds(self) -> bool | None:
        """Whether it is so in the runs at hand; None where a row is missing, or for a tie."""
        if self.advantage is None or abs(self.advantage.value) <= self.resolution:
            return None
        return self.advantage.value > 0

    @property
    def sure(self) -> bool:
        """Whether what the runs at hand show is more than the chance of seeds."""
        if self.advantage is None or self.holds is None:
            return False
        return self.advantage.n >= MIN_SEEDS and self.advantage.excludes(0.0)

    def to_mapping(self) -> dict[str, Any]:
        """:return: plain values, for JSON"""
        return {
            "metric": self.metric,
            "better": self.better,
            "worse": self.worse,
            "advantage": None if self.advantage is None else self.advantage.to_mapping(),
            "resolution": self.resolution,
            "holds": self.holds,
            "sure": self.sure,
        }


@dataclass(frozen=True)
class Finding:
    """A claim of the dissertation's and what the runs say about it.

    :param claim: in words
    :param task: ``push`` or ``pick-and-place``
    :param metric: what it is about
    :param comparisons: what it comes down to
    :param figures: the metric of every row that it is about
    :param missing: rows that it is about and that have not been run
    :param open: whether one of them could still make it true
    """

    claim: str
    task: str
    metric: Metric
    comparisons: Sequence[Comparison]
    figures: Mapping[str, Estimate]
    missing: Sequence[str] = ()
    open: bool = False

    @property
    def verdict(self) -> Verdict:
        """What the runs at hand show."""
        parts = [one.holds for one in self._known]
        if False in parts:
            return "cannot be told" if self.open else "does not hold"
        if not parts or None in parts:
            return "cannot be told"
        return "holds" if len(parts) == len(self.comparisons) else "holds so far"

    @property
    def beyond_seeds(self) -> BeyondSeeds:
        """Whether that is more than the chance of seeds."""
        if self.verdict not in ("holds", "does not hold"):
            return "-"
        # One comparison is enough to refute it; to confirm it takes all.
        wanted = self.verdict == "holds"
        deciding = [one for one in self.comparisons if one.holds is wanted]
        enough = all if wanted else any
        if enough(one.sure for one in deciding):
            return "yes"
        counted = (one.advantage is not None and one.advantage.n >= MIN_SEEDS for one in deciding)
        return "no" if enough(counted) else "too few seeds"

    @property
    def n(self) -> int:
        """Seeds behind the comparison that has fewest, 0 where none can be made."""
        return min((one.advantage.n for one in self._known if one.advantage), default=0)

    @property
    def closest(self) -> Comparison | None:
        """The comparison that comes nearest to refuting it, or does; None where no two rows are
        there to be compared.
        """
        return min(
            self._known, key=lambda one: one.advantage.value if one.advantage else 0, default=None
        )

    @property
    def _known(self) -> list[Comparison]:
        """The comparisons that can be made."""
        return [one for one in self.comparisons if one.advantage is not None]

    def text(self) -> str:
        """The closest comparison in words, with its figures."""
        one = self.closest
        if one is None or one.advantage is None:
            return "no two of its rows can be compared"
        parts = [
            f"{name}: {number(self.figures[name].value, self.metric)}"
            for name in (one.better, one.worse)
        ]
        gap = number(one.advantage.value, self.metric, signed=True)
        if one.advantage.interval is not None:
            low, high = (number(end, self.metric, signed=True) for end in one.advantage.interval)
            gap += f" [{low}, {high}]"
        told = f"{ABBREVIATIONS[self.metric]} of {parts[0]}, of {parts[1]}; advantage {gap}"
        resolvable = number(one.resolution, self.metric)
        return f"{told}, resolution {resolvable}" if one.resolution else told

    def to_mapping(self) -> dict[str, Any]:
        """:return: plain values, for JSON"""
        return {
            "claim": self.claim,
            "task": self.task,
            "metric": self.metric,
            "verdict": self.verdict,
            "beyond_seeds": self.beyond_seeds,
            "n": self.n,
            "missing": list(self.missing),
            "figures": {name: figure.to_mapping() for name, figure in self.figures.items()},
            "comparisons": [one.to_mapping() for one in self.comparisons],
        }


@dataclass(frozen=True)
class Claim:
    """What the dissertation reads off its Table 5.2.

    :param text: in words
    :param task: ``push`` or ``pick-and-place``
    :param metric: what it is about
    :param leaders: rows that are said to be better
    :param others: than each of these
    :param each: whether every leader is said to be, or only the best of them
    """

    text: str
    task: str
    metric: Metric
    leaders: Sequence[str]
    others: Sequence[str]
    each: bool = False


def claims(rows: Sequence[str]) -> list[Claim]:
    """The dissertation's findings about advising (its chapter 5), in its order.

    :param rows: of Table 5.2
    :return: the claims
    """
    advised = [row for row in rows if row != "none"]
    q_filters = [row for row in rows if row.startswith("mc-q ")]
    no_q = [row for row in rows if row not in q_filters]

    def first(text: str, row: str, task: str, metric: Metric) -> Claim:
        return Claim(text, task, metric, [row], [other for other in rows if other != row])

    elr: Metric = "effective_learning_rate"
    msr: Metric = "maximum_success_rate"
    looser = "a looser MC-Q threshold inspires earlier: 0.1 before 0.01"
    return [
        Claim("all advice beats none", "push", elr, advised, ["none"], each=True),
        Claim("all advice beats none", "pick-and-place", elr, advised, ["none"], each=True),
        Claim("MC-Q is first by ELR", "push", elr, q_filters, no_q),
        first("MC-ACTABS 0.01 has the highest MSR", "mc-actabs 0.01", "push", msr),
        first("MC-ACT 0.01 rises fastest", "mc-act 0.01", "push", "rise_time"),
        first("MC-ACT 0.01 rises fastest", "mc-act 0.01", "pick-and-place", "rise_time"),
        first("EA has the highest MSR", "early", "pick-and-place", msr),
        Claim(looser, "push", "inspired_epoch", ["mc-q 0.1"], ["mc-q 0.01"]),
        Claim(looser, "pick-and-place", "inspired_epoch", ["mc-q 0.1"], ["mc-q 0.01"]),
    ]


def judge(claim: Claim, table: Table) -> Finding:
    """Put a claim to the test.

    :param claim: of the dissertation
    :param table: the runs of its task
    :return: what they say
    """
    found = {name: table(claim.metric, name) for name in (*claim.leaders, *claim.others)}
    figures = {name: estimate(one.values) for name, one in found.items() if one and one.values}
    leaders = list(claim.leaders)
    if not claim.each:
        # A claim about a group is one about its best; of none of it where all are missing.
        sign = _sign(claim.metric)
        known = [name for name in leaders if name in figures]
        leaders = (
            [max(known, key=lambda name: sign * figures[name].value)] if known else leaders[:1]
        )
    comparisons = [
        _compare(claim.metric, leader, other, found)
        for leader in leaders
        for other in _contenders(claim.others, found)
    ]
    missing = [name for name, one in found.items() if one is None]
    still_open = not claim.each and any(name in missing for name in claim.leaders)
    return Finding(claim.text, claim.task, claim.metric, comparisons, figures, missing, still_open)


def _contenders(others: Sequence[str], found: Mapping[str, Measured | None]) -> list[str]:
    """The rows that a leader must beat: all but those that ran and have no such figure, which a row
    that hardly learned has not.
    """
    return [name for name in others if (one := found[name]) is None or one.values]


def table_of(rows: Iterable[MethodRow]) -> Table:
    """Look metrics up in summed-up runs.

    :param rows: of one task
    :return: the table; a row that hardly learned has no rise time, one that never succeeded no
        inspired epoch
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
    """A run's figure, and how finely it is known."""
    figures = run.metrics
    best = figures.maximum_success_rate
    of_success = success_resolution(best, run.episodes)
    if metric == "maximum_success_rate":
        return best, of_success
    if metric == "effective_learning_rate":
        rate = figures.effective_learning_rate
        if rate is None:
            return 0.0, 0.0
        # Of a quotient the relative errors add up; it is 0.9 MSR over so many epochs.
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
    advantage = difference(np.asarray(a.values), np.asarray(b.values))
    if metric in LOWER_IS_BETTER:
        advantage = difference(np.asarray(b.values), np.asarray(a.values))
    return Comparison(metric, better, worse, advantage, math.hypot(a.resolution, b.resolution))


def _sign(metric: Metric) -> int:
    return -1 if metric in LOWER_IS_BETTER else 1


def number(value: float, metric: Metric, signed: bool = False) -> str:
    """A figure of a metric as tables show it: epochs whole, rates with four digits.

    :param value: the figure
    :param metric: which
    :param signed: with a plus where it is not below 0
    :return: the text
    """
    digits = {"maximum_success_rate": 3, "effective_learning_rate": 4}.get(metric, 0)
    return f"{value:{'+' if signed else ''},.{digits}f}"
