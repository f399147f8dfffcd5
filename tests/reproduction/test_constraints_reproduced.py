"""Chapter 6's comparison: what is read, judged and rendered."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from run_files import curve, run_content, write_run

from reproduction.constraints.constraint_findings import (
    HINDSIGHT,
    METHOD,
    NO_EXPLORING,
    ON_POLICY,
    ChapterFinding,
    evaluated,
)
from reproduction.constraints.constraints_command import BEST, TASK, tables
from reproduction.program import main as reproduce
from saver_advisors.experiments.training_runs import read_training_runs

#: Of the runs of constraints_shared_arms.yml.
GROUP = "shared-arms"


def points(best: float, **more: Any) -> list[dict[str, Any]]:
    """A curve that rises to ``best``, with the rates of a task with a constraint."""
    return [
        {
            **point,
            "goal_success_rate": 0.9,
            "constraint_met_rate": point["success_rate"],
            "training_cost": 10.0 * point["steps"],
            **more,
        }
        for point in curve(10, best=best)
    ]


def write(folder: Path, row: str, best: float, seed: int = 0, **changes: Any) -> Path:
    """A run's file whose last policy has the rates of its curve's end."""
    final = {
        "success_rate": best,
        "goal_success_rate": 0.9,
        "constraint_met_rate": best,
        "deviation_mean": 0.004,
        "deviation_worst": 0.021,
        "cost_means": {"cost_distance": 1.5},
        "cost_cvar": {"cost_distance": 12.0},
        "ci95": [best, best],
        "episodes": 500,
    }
    return write_run(folder, TASK, row, seed, points(best), final=final, **changes)


def found_in(folder: Path) -> dict[str, ChapterFinding]:
    """The findings on the earlier learner's runs, by their text."""
    _, earlier = tables(read_training_runs([folder]))
    planned = (METHOD, *ON_POLICY, HINDSIGHT, NO_EXPLORING)
    return {one.text: one for one in evaluated(earlier, planned)}


def test_the_papers_own_figures_give_the_papers_findings(tmp_path: Path) -> None:
    write(tmp_path, "min", 0.7)
    for name in ("CPO", "TRPOLagrangian", "PPOLagrangian", HINDSIGHT):
        write(tmp_path, name, 0.0)
    decays = points(0.3)
    for point in decays[20:]:
        point["success_rate"] = 0.05
    write_run(tmp_path, TASK, "advising without the third stage", 0, decays)
    found = found_in(tmp_path).values()
    assert len(found) == 9
    assert {one.verdict for one in found} == {"holds"}
    assert {one.beyond for one in found} == {"too few seeds"}


@pytest.mark.parametrize(
    ("rates", "beyond"), [((0.66, 0.7, 0.72, 0.74), "yes"), ((0.2, 0.7, 0.9, 1.0), "no")]
)
def test_a_verdict_is_beyond_seeds_if_their_interval_is(
    tmp_path: Path, rates: tuple[float, ...], beyond: str
) -> None:
    for seed, rate in enumerate(rates):
        write(tmp_path, "min", rate, seed)
        write(tmp_path, "CPO", 0.0, seed)
    found = found_in(tmp_path)
    succeeds = found["The three stages as written (`min`) succeed: SR 0.70 at best"]
    assert (succeeds.verdict, succeeds.beyond) == ("holds", beyond)
    assert (found["CPO never succeeds"].verdict, found["CPO never succeeds"].beyond) == (
        "holds",
        "yes",
    )
    higher = found["The three stages as written have a higher SR than CPO"]
    assert (higher.verdict, higher.beyond) == ("holds", "yes")
    assert higher.evidence.endswith("(n = 4)")


def test_other_figures_refute_them_and_missing_rows_leave_them_open(tmp_path: Path) -> None:
    write(tmp_path, "min", 0.02)
    write(tmp_path, "CPO", 0.5)
    write(tmp_path, "advising without the third stage", 0.01)
    against = {text for text, one in found_in(tmp_path).items() if one.verdict == "does not hold"}
    assert against == {
        "The three stages as written (`min`) succeed: SR 0.70 at best",
        "CPO never succeeds",
        "Advising without the third stage rises a little and decays",
        "The three stages as written have a higher SR than CPO",
    }
    rest = {one.verdict for text, one in found_in(tmp_path).items() if text not in against}
    assert rest == {"cannot be told"}


def test_the_page_and_its_figures_come_from_the_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, page, out = tmp_path / "runs", tmp_path / "page.md", tmp_path / "out.json"
    folder.mkdir()
    for seed, rate in enumerate((0.8, 0.6)):
        shielded = {"success_rate": 0.95, "cost_means": {"cost_distance": 0.25}}
        write(folder, BEST, rate, seed, group=GROUP, shielded=shielded)
    write(folder, "min", 0.1, group=GROUP, name="of the grid")
    write(folder, "own value", 0.3)
    content = run_content(TASK, "linear", 0, points(0.4)[:10])
    (folder / "running.json").write_text(json.dumps({**content, "finished": False, "group": GROUP}))
    arguments = ["--results", str(folder), "--table", str(page), "--json", str(out)]
    assert reproduce(["constraints", *arguments, "--figures", str(tmp_path / "f")]) == 0
    assert "own value" in capsys.readouterr().out
    now, _, earlier = page.read_text().partition("## The earlier learner")
    [row] = [line for line in now.splitlines() if line.startswith(f"| {BEST} | 2")]
    assert "0.700 [0.600, 0.800]" in row and "| 4.0" in row and "| 21" in row
    assert "| 12.0" in row, "the CVaR of the cost"
    assert "10,000,000" in row, "steps outside the band while training"
    assert f"| {BEST}, with a shield | 2" in now and "| 0.950" in now
    assert now.index(f"| {BEST}") < now.index("| min |"), "the best row is first"
    assert "| min | 1 | -0.600 | too few seeds |" in now
    assert "Not finished, and not counted: linear seed 0" in now
    assert f"{BEST} (2 of 5)" in now and "CPO (0 of 5)" in now, "missing seeds"
    assert "| own value" not in now and "| own value | 1 |" in earlier
    assert "SR at 50%" in earlier
    for name in ("success-rate", "goal-success-rate", "constraint-met-rate"):
        assert f"f/{name}.png" in now and (tmp_path / "f" / f"{name}.png").stat().st_size > 1000
    recorded = {row["row"]: row for row in json.loads(out.read_text())["rows"]}
    assert recorded[BEST]["success_rate"]["value"] == pytest.approx(0.7)
    assert recorded["linear"]["success_rate"] is None
    # What it wrote may lie among the runs' files.
    (folder / "rendered.json").write_text(out.read_text())
    assert not read_training_runs([folder]).skipped


def test_without_a_run_of_the_grid_the_page_says_so(tmp_path: Path) -> None:
    write(tmp_path, "own value", 0.3)
    page = tmp_path / "page.md"
    assert reproduce(["constraints", "--results", str(tmp_path), "--table", str(page)]) == 0
    now = page.read_text().partition("## The earlier learner")[0]
    assert "No run has finished yet." in now and f"{BEST} (0 of 5)" in now
    assert "## Findings" not in now


def test_minutes_on_several_threads_say_so(tmp_path: Path) -> None:
    folder, page = tmp_path / "runs", tmp_path / "page.md"
    folder.mkdir()
    write(folder, "linear", 0.5)
    two = {"command": "saver experiments run grid.yml --threads 2", "commit": "0" * 40}
    write(folder, "own value", 0.8, provenance=two)
    assert reproduce(["constraints", "--results", str(folder), "--table", str(page)]) == 0
    lines = page.read_text().splitlines()
    told = {
        name: [line for line in lines if line.startswith(f"| {name}")]
        for name in ("own value", "linear")
    }
    # In the tables of methods and of equal time, not in that of curves.
    assert [line.count("on 2 threads") for line in told["own value"]] == [1, 0, 1]
    assert not any("threads" in line for line in told["linear"])


def test_runs_of_another_task_are_no_answer(tmp_path: Path, capsys: Any) -> None:
    write_run(tmp_path, "DualJacoPush-v0", "none", 0, curve(10))
    assert reproduce(["constraints", "--results", str(tmp_path)]) != 0
    assert "no run of DualJacoDistance-v0 there, only of DualJacoPush-v0" in capsys.readouterr().err
