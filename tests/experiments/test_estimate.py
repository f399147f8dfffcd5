"""`saver experiments estimate`: what it counts, never how long anything takes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from tiny_grids import GridFile, tiny_grid

from saver_advisors.cli import main
from saver_advisors.experiments import estimate
from saver_advisors.experiments.estimate import RowEstimate, estimate_row, rows_of
from saver_advisors.experiments.grid import read_grid

ALGORITHMS = Path(__file__).resolve().parents[1] / "benchmarks" / "algorithms.py"


def test_a_grid_is_estimated(
    grid_file: GridFile, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = tiny_grid(total_steps=400)
    content["groups"]["push"]["rows"]["mine"] = {"algorithm": f"{ALGORITHMS}:Drifter"}
    figures = tmp_path / "estimate.json"
    words = ["experiments", "estimate", str(grid_file(content)), "--steps", "30"]
    assert main([*words, "--json", str(figures)]) == 0
    found = json.loads(figures.read_text())
    assert (found["kind"], found["runs"], found["steps"]) == ("estimate", 4, 1600)
    assert [(one["row"], one["runs"]) for one in found["rows"]] == [
        ("none", 1),
        ("early", 2),
        ("mine", 1),
    ]
    # Ten evaluations of two episodes, and the final two, for two policies of another's algorithm.
    assert [one["episodes"] for one in found["rows"]] == [22, 22, 24]
    assert all(one["step_s"] > 0 and one["episode_s"] > 0 for one in found["rows"])
    assert found["core_hours"] == pytest.approx(sum(one["core_hours"] for one in found["rows"]))
    assert "tiny: 4 runs, 1,600 steps" in capsys.readouterr().out
    assert {path.name for path in tmp_path.iterdir()} == {"grid.yml", "estimate.json"}


def test_core_hours_are_those_of_training_and_evaluations() -> None:
    row = RowEstimate("g", "r", runs=3, steps=1000, episodes=50, step_s=3.6, episode_s=72.0)
    assert row.core_hours == 3 * (1.0 + 1.0)


@pytest.mark.parametrize(
    ("given", "steps", "total", "slice_"),
    [
        (0, 30, 10_000, (40, 80)),  # whole blocks of 20 steps
        (100, 30, 10_000, (120, 160)),  # after the first updates
        (0, 30, 60, (30, 60)),  # no more than the run has
    ],
)
def test_the_slice_begins_after_the_first_updates(
    given: int,
    steps: int,
    total: int,
    slice_: tuple[int, int],
    grid_file: GridFile,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    content = tiny_grid(total_steps=total, learning_starts=given)
    row = {"algorithm": f"{ALGORITHMS}:Drifter", "algo_kwargs": {"learning_starts": given}}
    content["groups"]["push"]["rows"] = {"ours": {}, "mine": row}
    times: list[tuple[int, int]] = []

    def note(config: object, start: int, end: int, folder: Path) -> tuple[float, float]:
        times.append((start, end))
        return 1.0, 1.0

    monkeypatch.setattr(estimate, "_own_slice", note)
    monkeypatch.setattr(estimate, "_other_slice", note)
    for runs in rows_of(read_grid(grid_file(content))):
        estimate_row(runs, steps)
    assert times == [slice_, slice_]


def test_an_algorithm_that_cannot_be_built_is_named(
    grid_file: GridFile, capsys: pytest.CaptureFixture[str]
) -> None:
    content = tiny_grid()
    row = {"algorithm": f"{ALGORITHMS}:Drifter", "algo_kwargs": {"speed": -1}}
    content["groups"]["push"]["rows"] = {"mine": row}
    assert main(["experiments", "estimate", str(grid_file(content)), "--steps", "20"]) == 2
    assert "speed=-1" in capsys.readouterr().err
