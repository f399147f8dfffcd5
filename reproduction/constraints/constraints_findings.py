"""Evaluate the dissertation's findings about the distance task on training runs.

Chapter 6 shows curves (Figures 6.1 and 6.2) and no table. Here its findings are thresholds:
"succeeds" is a success rate of at least half of the 0.70 that it shows at best, and "never
succeeds" one of at most 0.05.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from reproduction.findings import Verdict, verdict_of
from saver_advisors.experiments.summary import MethodRow, success_resolution
from saver_advisors.experiments.training_runs import TrainingRun

PAPER_BEST: Final = 0.70
"""Highest SR of the three stages in Figure 6.2."""
SUCCEEDS: Final = PAPER_BEST / 2
NEVER: Final = 0.05

METHOD: Final = "min"
NO_EXPLORING: Final = "advising without the third stage"
#: Rows of the table, by the class names of `saver benchmark run` and one name of the grid -> names
#: on the page.
BASELINES: Final[Mapping[str, str]] = {
    "CPO": "CPO",
    "TRPOLagrangian": "TRPO-Lagrangian",
    "PPOLagrangian": "PPO-Lagrangian",
    "hindsight alone": "HER that is conditioned on the constraint",
}


@dataclass(frozen=True)
class ConstraintFinding:
    """One finding of the chapter.

    :param text: the finding in words.
    :param verdict: whether it holds in these runs.
    :param evidence: the figures behind the verdict.
    """

    text: str
    verdict: Verdict
    evidence: str

    def to_mapping(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        return asdict(self)


Rule = Callable[[MethodRow], tuple[bool | None, str]]
"""Whether a finding holds for a row (None: cannot be told), and the figures that decide it."""


def evaluate_findings(rows: Sequence[MethodRow]) -> list[ConstraintFinding]:
    """Evaluate every finding.

    :param rows: rows of the distance task.
    :return: the findings; those about missing rows cannot be told.
    """
    named = {row.name: row for row in rows if row.n}

    def evaluate(text: str, name: str, rule: Rule) -> ConstraintFinding:
        if name not in named:
            return ConstraintFinding(text, verdict_of(None), "no finished run")
        holds, figures = rule(named[name])
        return ConstraintFinding(text, verdict_of(holds), f"{figures} (n = {named[name].n})")

    succeed = f"The three stages as written (`{METHOD}`) succeed: SR {PAPER_BEST:.2f} at best"
    decays = "Advising without the third stage rises a little and decays"
    return [
        evaluate(succeed, METHOD, _succeeds),
        *(evaluate(f"{label} never succeeds", name, _never) for name, label in BASELINES.items()),
        evaluate(decays, NO_EXPLORING, _decays),
    ]


def _bests(row: MethodRow) -> list[float]:
    """Return the highest success rate of each run."""
    return [float(run.curve.success.max()) for run in row.runs]


def _succeeds(row: MethodRow) -> tuple[bool | None, str]:
    best = max(_bests(row))
    near = abs(best - SUCCEEDS) <= success_resolution(best, row.runs[0].episodes)
    return None if near else best >= SUCCEEDS, f"SR {best:.2f} at best"


def _never(row: MethodRow) -> tuple[bool | None, str]:
    best = max(_bests(row))
    return best <= NEVER, f"SR {best:.2f} at best"


def _decays(row: MethodRow) -> tuple[bool | None, str]:
    """Compare the highest success with the success at the end."""
    best = float(np.mean(_bests(row)))
    last = float(np.mean([_last(run) for run in row.runs]))
    resolved = best - last > success_resolution(best, row.runs[0].episodes)
    holds = False if max(_bests(row)) <= NEVER else resolved or None
    return holds, f"SR {best:.2f} at best, {last:.2f} in the last quarter"


def _last(run: TrainingRun) -> float:
    """Compute the mean success of the last quarter of a curve."""
    success = np.asarray(run.curve.success)
    return float(success[-max(1, len(success) // 4) :].mean())
