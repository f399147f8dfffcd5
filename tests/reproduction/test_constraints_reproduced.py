"""Chapter 6's comparison: what is read, judged and rendered."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from run_files import curve, run_content, write_run

from reproduction.constraints.constraints_command import TASK, evaluated, table
from reproduction.program import main as reproduce
from saver_advisors.experiments.training_runs import read_training_runs


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
        "ci95": [best, best],
        "episodes": 500,
    }
    return write_run(folder, TASK, row, seed, points(best), final=final, **changes)


def verdicts(folder: Path) -> dict[str, str]:
    """Each finding's verdict, by the first words of its text."""
    found = evaluated(table(read_training_runs([folder])))
    return {one["text"].split(" ")[0]: one["verdict"] for one in found}


def test_the_papers_own_figures_give_the_papers_findings(tmp_path: Path) -> None:
    write(tmp_path, "min", 0.7)
    for name in ("CPO", "TRPOLagrangian", "PPOLagrangian", "hindsight alone"):
        write(tmp_path, name, 0.0)
    decays = points(0.3)
    for point in decays[20:]:
        point["success_rate"] = 0.05
    write_run(tmp_path, TASK, "advising without the third stage", 0, decays)
    assert set(verdicts(tmp_path).values()) == {"holds"}


def test_other_figures_refute_them_and_missing_rows_leave_them_open(tmp_path: Path) -> None:
    write(tmp_path, "min", 0.02)
    write(tmp_path, "CPO", 0.5)
    write(tmp_path, "advising without the third stage", 0.01)
    assert verdicts(tmp_path) == {
        "The": "does not hold",
        "CPO": "does not hold",
        "Advising": "does not hold",
        **dict.fromkeys(("TRPO-Lagrangian", "PPO-Lagrangian", "HER"), "cannot be told"),
    }


def test_the_page_and_its_figures_come_from_the_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, page, out = tmp_path / "runs", tmp_path / "page.md", tmp_path / "out.json"
    folder.mkdir()
    write(folder, "own value", 0.8)
    write(folder, "own value", 0.6, seed=1)
    write(folder, "min", 0.1)
    content = run_content(TASK, "linear", 0, points(0.4)[:10])
    (folder / "running.json").write_text(json.dumps({**content, "finished": False}))
    arguments = ["--results", str(folder), "--table", str(page), "--json", str(out)]
    assert reproduce(["constraints", *arguments, "--figures", str(tmp_path / "f")]) == 0
    assert "own value" in capsys.readouterr().out
    text = page.read_text()
    rows = [line for line in text.splitlines() if line.startswith("| own value")]
    assert "0.700 [0.600, 0.800]" in rows[0] and "| 4.0" in rows[0] and "| 21" in rows[0]
    assert "10,000,000" in rows[0], "steps outside the band while training"
    assert text.index("| own value") < text.index("| min |"), "the best row is first"
    assert "Not finished, and not counted: linear seed 0" in text
    for name in ("success-rate", "goal-success-rate", "constraint-met-rate"):
        assert f"f/{name}.png" in text and (tmp_path / "f" / f"{name}.png").stat().st_size > 1000
    recorded = {row["row"]: row for row in json.loads(out.read_text())["rows"]}
    assert recorded["own value"]["success_rate"]["value"] == pytest.approx(0.7)
    assert recorded["linear"]["success_rate"] is None
    # What it wrote may lie among the runs' files.
    (folder / "rendered.json").write_text(out.read_text())
    assert not read_training_runs([folder]).skipped


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
    assert [line.count("on 2 threads") for line in told["own value"]] == [1, 1]
    assert not any("threads" in line for line in told["linear"])


def test_runs_of_another_task_are_no_answer(tmp_path: Path, capsys: Any) -> None:
    write_run(tmp_path, "DualJacoPush-v0", "none", 0, curve(10))
    assert reproduce(["constraints", "--results", str(tmp_path)]) != 0
    assert "no run of DualJacoDistance-v0 there, only of DualJacoPush-v0" in capsys.readouterr().err
