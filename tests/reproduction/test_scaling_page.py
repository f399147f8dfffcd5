"""What more cores and a GPU would give: the computation, its page, and models in MuJoCo Warp."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from reproduction.pages.scaling import (
    FILES,
    GRID,
    TRIALS,
    faster,
    grid_row,
    grids_of,
    makespan,
    overhead_s,
    run_rows,
    scaling_page,
)
from reproduction.program import main as reproduce
from reproduction.warp_models import table_of
from saver_advisors.cli import main
from saver_advisors.experiments.training_runs import read_training_runs

RESULTS = Path(__file__).resolve().parents[2] / "docs" / "results"


@given(
    st.lists(st.floats(0.1, 100.0), min_size=1, max_size=30), st.integers(1, 40), st.integers(1, 9)
)
def test_a_makespan_is_within_its_bounds(durations: list[float], cores: int, more: int) -> None:
    end = makespan(durations, cores)
    least = max(max(durations), sum(durations) / cores)
    assert least * (1 - 1e-9) <= end <= (sum(durations) / cores + max(durations)) * (1 + 1e-9)
    if cores + more >= len(durations):
        assert makespan(durations, max(cores + more, len(durations))) == max(durations)


def test_runs_begin_in_order_on_the_first_free_core() -> None:
    assert makespan([3, 1, 2, 4], 1) == 10
    assert makespan([3, 1, 2, 4], 2) == 7
    assert makespan([4, 3, 2, 1], 2) == 5


def test_more_speed_of_a_part() -> None:
    assert faster(0.5, 1.0) == 1.0
    assert faster(0.5, 2.0) == pytest.approx(4 / 3)
    assert faster(0.25, float("inf")) == pytest.approx(4 / 3)


def a_run(row: str, seed: int, seconds: float) -> dict[str, Any]:
    curve = [
        {"steps": steps, "success_rate": 0.5, "wall_clock_s": seconds * steps / 100}
        for steps in (50, 100)
    ]
    config = {"env_id": "X-v0", "total_steps": 100, "seed": seed}
    return {"kind": "training-run", "row": row, "seed": seed, "config": config, "curve": curve}


def test_grids_of_measured_runs(tmp_path: Path) -> None:
    for row, seed, seconds in (("a", 0, 100.0), ("a", 1, 200.0), ("b", 0, 500.0)):
        (tmp_path / f"{row}{seed}.json").write_text(json.dumps(a_run(row, seed, seconds)))
    grids = grids_of(read_training_runs([tmp_path]).runs, overhead=10.0, evaluations=0.1)
    assert sorted(grids["measured"]) == pytest.approx([120, 230, 560])
    assert sorted(grids["protocol"]) == pytest.approx([120, 175, 175, 175, 230] + [560] * 5)
    assert grids["search"] == pytest.approx([910 / 3] * TRIALS)
    row = grid_row(grids, 2)
    assert row["measured"] == pytest.approx((680 / 3600, 910 / 1360))
    assert row["search"] == pytest.approx((TRIALS / 2 * 910 / 3 / 3600, 1.0))


def test_overhead_is_that_of_the_largest_cluster() -> None:
    rows = [
        {"backend": backend, "workers": workers, "idle_s": idle, "starting_s": 2.0}
        for backend, workers, idle in (("processes", 4, 1.0), ("ray", 1, 3.0), ("ray", 2, 5.0))
    ]
    assert overhead_s({"rows": rows}) == 7.0


def test_parts_of_a_run() -> None:
    parts = {"simulation": 40.0, "critics' step": 20.0, "actor's step": 10.0}
    parts |= {"drawing and relabelling": 10.0, "the rest": 20.0}
    learning = {"rows": [{"env": "X", "n_envs": 16, "parts": parts, "total": 100.0}]}
    speed = {"env": "X", "n_envs": 16, "threads": 2, "speed_up_of_threads": 2.0}
    [row] = run_rows(learning, {"rows": [{**speed, "threads": 1}, speed]})
    assert (row["simulation"], row["updates"]) == (0.4, 0.4)
    assert row["threaded"] == pytest.approx(1.25)
    assert row["no_simulation"] == pytest.approx(1 / 0.6)


def test_the_page_is_made_of_measurements(tmp_path: Path) -> None:
    text = scaling_page(RESULTS)
    assert text is not None
    scaling = json.loads((RESULTS / "scaling.json").read_text())
    for row in scaling["rows"]:
        assert f"| {row['runs_per_hour']:.0f} | {row['efficiency']:.0%} |" in text
    assert all(
        re.search(rf"^\| {cores} \| .* busy \|$", text, re.M) for cores in ("1", "10", "1,000")
    )
    for name in FILES:
        (tmp_path / f"{name}.json").write_text((RESULTS / f"{name}.json").read_text())
    assert scaling_page(tmp_path) is None, "without the runs of the grid"
    (tmp_path / GRID).symlink_to(RESULTS / GRID)
    assert scaling_page(tmp_path) == text
    (tmp_path / "speed.json").unlink()
    assert scaling_page(tmp_path) is None


def test_measured_scaling_is_shown_again(capsys: pytest.CaptureFixture[str]) -> None:
    path = RESULTS / "scaling.json"
    assert main(["benchmark", "scaling", "--from", str(path)]) == 0
    said = capsys.readouterr().out
    scaling = json.loads(path.read_text())
    assert f"has {scaling['hardware_threads']} hardware threads" in said
    assert f"{scaling['checkpoint']['megabytes']:.0f}" in said


# --- MuJoCo Warp --------------------------------------------------------------------------------


def test_models_that_are_not_accepted_have_a_row() -> None:
    step = {"actions": 0, "contacts": 4, "qpos_difference": 1e-7, "qvel_difference": 2e-6}
    step |= {"qpos_change": 0.1, "qvel_change": 0.2}
    steps = [step, {**step, "actions": 20}]
    rows = [
        {"env": "A", "accepted": True, "unsupported": None, "steps": steps},
        {"env": "B", "accepted": False, "unsupported": "Body plugins.", "steps": []},
    ]
    lines = table_of({"rows": rows}).splitlines()[2:]
    assert lines == [
        "| A | yes | at the start | 4 | 1.0e-07 | 2.0e-06 | 2.0e-01 |",
        "| A | yes | after 20 actions | 4 | 1.0e-07 | 2.0e-06 | 2.0e-01 |",
        "| B | no: Body plugins. | - | - | - | - | - |",
    ]


@pytest.mark.long
def test_a_step_agrees_with_mujoco(tmp_path: Path) -> None:
    pytest.importorskip("mujoco_warp")
    path = tmp_path / "warp.json"
    words = ["warp", "--only", "JacoPush-v0", "--actions", "10", "--json", str(path)]
    assert reproduce(words) == 0
    [row] = json.loads(path.read_text())["rows"]
    assert row["accepted"]
    assert [step["actions"] for step in row["steps"]] == [0, 10]
    for step in row["steps"]:
        assert step["qpos_difference"] < 1e-5
        assert step["qvel_difference"] < 1e-3 < 1e-2 < step["qvel_change"]
