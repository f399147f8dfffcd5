"""Evaluate the findings of chapter 6 on training runs, and compare rows over their seeds.

Chapter 6 shows curves (Figures 6.1 and 6.2) and no table. Here its findings are thresholds:
"succeeds" is a success rate of at least half of the 0.70 that it shows at best, and "never
succeeds" one of at most 0.05 at every evaluation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from reproduction.findings import (
    BeyondSeeds,
    Verdict,
    beyond_seeds,
    success_resolution,
    verdict_of,
)
from saver_advisors.evaluation.statistics import Estimate, difference, estimate
from saver_advisors.experiments.summary import MethodRow
from saver_advisors.experiments.training_runs import TrainingRun

PAPER_BEST: Final = 0.70
"""Highest SR of the three stages in Figure 6.2."""
SUCCEEDS: Final = PAPER_BEST / 2
NEVER: Final = 0.05

METHOD: Final = "min"
NO_EXPLORING: Final = "advising without the third stage"
ON_POLICY: Final = ("CPO", "TRPO-Lagrangian", "PPO-Lagrangian")
#: The chapter's, and one that also learns in hindsight.
LIMITED: Final = (*ON_POLICY, "TD3-Lagrangian")
HINDSIGHT: Final = "hindsight alone"


@dataclass(frozen=True)
class ChapterFinding:
    """A claim, evaluated on training runs.

    :param text: the claim in words.
    :param verdict: what these runs show.
    :param beyond: whether that exceeds the variation between seeds.
    :param evidence: the figures that decide it.
    """

    text: str
    verdict: Verdict
    beyond: BeyondSeeds
    evidence: str


Answer = tuple[bool | None, BeyondSeeds, str]
"""Whether a claim holds (None: cannot be told), whether beyond seeds, and the figures."""
Rule = Callable[[MethodRow], Answer]


def evaluated(rows: Sequence[MethodRow], planned: Collection[str]) -> list[ChapterFinding]:
    """Evaluate the claims of chapter 6 on the rows of one learner.

    :param rows: rows of the distance task.
    :param planned: names of rows with runs, or for which they are planned; there are findings about
        these alone, which cannot be told without finished runs.
    :return: the findings.
    """
    named = {row.name: row for row in rows if row.n}
    method = named.get(METHOD)
    succeed = f"The three stages as written (`{METHOD}`) succeed: SR {PAPER_BEST:.2f} at best"
    her = "HER that is conditioned on the constraint never succeeds"
    decays = "Advising without the third stage rises a little and decays"
    higher = "The three stages as written have a higher SR than "
    claims: list[tuple[str, str, Rule]] = [
        (succeed, METHOD, _succeeds),
        *((f"{name} never succeeds", name, _never) for name in ON_POLICY),
        (her, HINDSIGHT, _never),
        (decays, NO_EXPLORING, _decays),
        *((higher + name, name, _lower_than(method)) for name in LIMITED),
    ]
    return [_finding(text, named.get(name), rule) for text, name, rule in claims if name in planned]


def _finding(text: str, row: MethodRow | None, rule: Rule) -> ChapterFinding:
    if row is None:
        return ChapterFinding(text, verdict_of(None), "-", "no finished run")
    holds, beyond, evidence = rule(row)
    return ChapterFinding(text, verdict_of(holds), beyond, evidence)


def advantage(row: MethodRow, other: MethodRow) -> tuple[Estimate, float] | None:
    """Compare the last policies' success rates of two rows.

    :param row: with finished runs.
    :param other: likewise.
    :return: by how much the SR of the first is higher, and the smallest difference that the
        episodes can resolve; None if a row has no final evaluation.
    """
    rates = [
        [run.final_success for run in one.runs if run.final_success is not None]
        for one in (row, other)
    ]
    if not all(rates):
        return None
    resolutions = [
        success_resolution(float(np.mean(values)), _final_episodes(one) * len(values))
        for values, one in zip(rates, (row, other), strict=True)
    ]
    return difference(*rates), math.hypot(*resolutions)


def _final_episodes(row: MethodRow) -> int:
    return min(int(run.final["episodes"]) for run in row.runs if run.final)


def _lower_than(method: MethodRow | None) -> Rule:
    """Make the rule that a row's SR is lower than the method's."""

    def rule(row: MethodRow) -> Answer:
        compared = None if method is None else advantage(method, row)
        if compared is None:
            return None, "-", f"no final evaluation of `{METHOD}`, or of this row"
        gap, resolution = compared
        holds = None if abs(gap.value) <= resolution else gap.value > 0
        beyond = beyond_seeds(holds, gap.n, gap.excludes(0.0))
        return holds, beyond, f"SR higher by {gap.text(3)} (n = {gap.n})"

    return rule


def _bests(row: MethodRow) -> Estimate:
    """Estimate the highest success rate of a run over its evaluations."""
    return estimate([float(run.curve.success.max()) for run in row.runs])


def _succeeds(row: MethodRow) -> Answer:
    best = _bests(row)
    near = abs(best.value - SUCCEEDS) <= success_resolution(best.value, row.runs[0].episodes)
    holds = None if near else best.value >= SUCCEEDS
    return holds, beyond_seeds(holds, best.n, best.excludes(SUCCEEDS)), _at_best(best)


def _never(row: MethodRow) -> Answer:
    best = _bests(row)
    holds = max(float(run.curve.success.max()) for run in row.runs) <= NEVER
    return holds, beyond_seeds(holds, best.n, best.excludes(NEVER)), _at_best(best)


def _at_best(best: Estimate) -> str:
    return f"SR {best.text(2)} at best (n = {best.n})"


def _decays(row: MethodRow) -> Answer:
    """Compare the highest success with the success at the end."""
    best = _bests(row)
    falls = estimate([float(run.curve.success.max()) - _last(run) for run in row.runs])
    resolved = falls.value > success_resolution(best.value, row.runs[0].episodes)
    holds = False if best.value <= NEVER else resolved or None
    excludes = best.excludes(NEVER) and falls.excludes(0.0)
    last = best.value - falls.value
    evidence = f"SR {best.value:.2f} at best, {last:.2f} in the last quarter (n = {row.n})"
    return holds, beyond_seeds(holds, row.n, excludes), evidence


def _last(run: TrainingRun) -> float:
    """Compute the mean success of the last quarter of a curve."""
    success = np.asarray(run.curve.success)
    return float(success[-max(1, len(success) // 4) :].mean())
