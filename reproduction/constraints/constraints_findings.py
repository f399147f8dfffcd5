"""What chapter 6 finds about the distance task, each put to the test of a table of runs.

The dissertation shows curves (Figures 6.1 and 6.2) and no table; what it reads off them is here in
numbers: "succeeds" is a success rate of at least half of the 0.70 that it shows at best, "never
succeeds" one of at most 0.05.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from reproduction.findings import Verdict
from saver_advisors.experiments.summary import MethodRow, success_resolution
from saver_advisors.experiments.training_runs import TrainingRun

PAPER_BEST: Final = 0.70
"""SR of the three stages at best, as Figure 6.2 shows it."""
SUCCEEDS: Final = PAPER_BEST / 2
NEVER: Final = 0.05

METHOD: Final = "min"
NO_EXPLORING: Final = "advising without the third stage"
#: Rows of the table: the classes' names, which `saver benchmark run` calls them by, and one of the
#: grid's.
BASELINES: Final[Mapping[str, str]] = {
    "CPO": "CPO",
    "TRPOLagrangian": "TRPO-Lagrangian",
    "PPOLagrangian": "PPO-Lagrangian",
    "hindsight alone": "HER that is conditioned on the constraint",
}


@dataclass(frozen=True)
class ConstraintFinding:
    """One finding of the chapter.

    :param text: what it says
    :param verdict: in these runs
    :param evidence: the figures behind the verdict, in words
    """

    text: str
    verdict: Verdict
    evidence: str

    def to_mapping(self) -> dict[str, Any]:
        """:return: plain values, for JSON"""
        return {"text": self.text, "verdict": self.verdict, "evidence": self.evidence}


def judge_all(rows: Sequence[MethodRow]) -> list[ConstraintFinding]:
    """Every finding, judged.

    :param rows: of the distance task
    :return: the findings; those about rows that are missing cannot be told
    """
    named = {row.name: row for row in rows if row.n}
    return [
        _succeeds(named.get(METHOD)),
        *(_never(label, named.get(name)) for name, label in BASELINES.items()),
        _decays(named.get(NO_EXPLORING)),
    ]


def _succeeds(row: MethodRow | None) -> ConstraintFinding:
    text = f"The three stages as written (`{METHOD}`) succeed: SR {PAPER_BEST:.2f} at best"
    if row is None:
        return ConstraintFinding(text, "cannot be told", "no finished run")
    best = max(float(run.curve.success.max()) for run in row.runs)
    near = abs(best - SUCCEEDS) <= success_resolution(best, row.runs[0].episodes)
    verdict: Verdict = "holds" if best >= SUCCEEDS else "does not hold"
    return ConstraintFinding(
        text, "cannot be told" if near else verdict, f"SR {best:.2f} at best ({_seeds(row)})"
    )


def _never(label: str, row: MethodRow | None) -> ConstraintFinding:
    text = f"{label} never succeeds"
    if row is None:
        return ConstraintFinding(text, "cannot be told", "no finished run")
    best = max(float(run.curve.success.max()) for run in row.runs)
    return ConstraintFinding(
        text,
        "holds" if best <= NEVER else "does not hold",
        f"SR {best:.2f} at best ({_seeds(row)})",
    )


def _decays(row: MethodRow | None) -> ConstraintFinding:
    """A little success while the advice lasts, and less of it in the end."""
    text = "Advising without the third stage rises a little and decays"
    if row is None:
        return ConstraintFinding(text, "cannot be told", "no finished run")
    best = [float(run.curve.success.max()) for run in row.runs]
    last = [_last(run) for run in row.runs]
    apart = float(np.mean(best)) - float(np.mean(last))
    resolution = success_resolution(float(np.mean(best)), row.runs[0].episodes)
    verdict: Verdict = "holds" if apart > resolution else "cannot be told"
    if max(best) <= NEVER:
        verdict = "does not hold"
    return ConstraintFinding(
        text,
        verdict,
        f"SR {np.mean(best):.2f} at best, {np.mean(last):.2f} in the last quarter ({_seeds(row)})",
    )


def _last(run: TrainingRun) -> float:
    """Mean success of the last quarter of a curve."""
    success = np.asarray(run.curve.success)
    return float(success[-max(1, len(success) // 4) :].mean())


def _seeds(row: MethodRow) -> str:
    return f"n = {row.n}"
