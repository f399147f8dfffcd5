"""Grids: what a file turns into, and what is wrong with one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from tiny_grids import GridFile, tiny_grid

from saver_advisors.experiments import ExperimentRun, read_grid

CONFIGS = Path(__file__).resolve().parents[2] / "zoo_configs"


def test_first_seeds_of_all_rows_come_first(grid_file: GridFile) -> None:
    grid = read_grid(grid_file(tiny_grid()))
    assert [run.name for run in grid.runs] == [
        "push-none-seed0",
        "push-early-seed0",
        "push-early-seed1",
    ]
    assert [run.config.seed for run in grid.runs] == [0, 0, 1]
    assert {run.final_episodes for run in grid.runs} == {2}


def test_budget_is_a_share_of_the_run(grid_file: GridFile) -> None:
    grid = read_grid(grid_file(tiny_grid(total_steps=1000)))
    none, early, _ = grid.runs
    assert none.config.advice is None, "the environment's own advice must not slip in"
    assert early.config.advice is not None
    assert (early.config.advice.strategy, early.config.advice.budget) == ("early", 250)


def test_a_row_may_say_otherwise(grid_file: GridFile) -> None:
    content = tiny_grid()
    content["groups"]["push"]["rows"]["early"] |= {
        "settings": {"batch_size": 32},
        "advice": {"strategy": "early", "budget": 7},
    }
    _, early, _ = read_grid(grid_file(content)).runs
    assert early.config.batch_size == 32
    assert early.config.advice is not None
    assert early.config.advice.budget == 7
    assert early.config.net_arch == (8,), "the group's settings stay"


def test_a_run_survives_json(grid_file: GridFile) -> None:
    for run in read_grid(grid_file(tiny_grid())).runs:
        assert ExperimentRun.from_mapping(run.to_mapping()) == run


def _break(content: dict[str, Any], path: str, value: Any) -> dict[str, Any]:
    *outer, last = path.split("/")
    place = content
    for key in outer:
        place = place[key]
    place[last] = value
    return content


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("surplus", 1, "unknown ['surplus']"),
        ("final_episodes", 0, "final_episodes=0"),
        ("final_episodes", "many", "final_episodes='many'"),
        ("groups", {}, "give at least one"),
        ("groups/push/env_id", "Push-v9", "env_id='Push-v9'"),
        ("groups/push/seed", 1, "unknown ['seed']"),
        ("groups/push/budget_fraction", 1.5, "budget_fraction=1.5"),
        ("groups/push/rows/early/seeds", [0, 0], "would have the name push-early-seed0"),
        ("groups/push/rows/early/seeds", [-1], "seeds=[-1]"),
        ("groups/push/rows/early/seeds", [], "seeds=[]"),
        ("groups/push/rows/early/advice", {"strategy": "early", "nudge": 1}, "nudge"),
        ("groups/push/rows/none", {"settings": {"speed": 1}}, "push.none: unknown speed"),
        ("groups/push/settings", {"batch_size": "big"}, "batch_size='big'"),
    ],
)
def test_what_is_wrong_is_named(grid_file: GridFile, path: str, value: Any, message: str) -> None:
    file = grid_file(_break(tiny_grid(), path, value))
    with pytest.raises(ValueError) as caught:
        read_grid(file)
    assert message in str(caught.value)
    assert str(file) in str(caught.value)


def test_no_yaml(tmp_path: Path) -> None:
    path = tmp_path / "grid.yml"
    path.write_text("groups: [", encoding="utf-8")
    with pytest.raises(ValueError, match="not valid YAML"):
        read_grid(path)


def test_only_some(grid_file: GridFile) -> None:
    grid = read_grid(grid_file(tiny_grid()))
    assert [run.name for run in grid.only(["seed1", "none"]).runs] == [
        "push-none-seed0",
        "push-early-seed1",
    ]
    assert grid.only([]) is grid
    with pytest.raises(ValueError, match="no run has mc-q in its name"):
        grid.only(["mc-q"])


def test_the_shipped_grid_has_the_rows_of_the_table() -> None:
    grid = read_grid(CONFIGS / "advising.yml")
    strategies = {
        (run.row, None if run.config.advice is None else run.config.advice.strategy)
        for run in grid.runs
        if run.config.env_id == "DualJacoPush-v0" and run.config.per_arm_critics
    }
    for strategy in ("mc-q", "mc-act", "mc-actabs"):
        for threshold in ("0.01", "0.05", "0.1"):
            assert (f"{strategy} {threshold}", strategy) in strategies
    assert {("none", None), ("early", "early"), ("early-mc", "early-mc")} <= strategies
    # Runs of a group differ in advice and seed alone.
    for group in {run.group for run in grid.runs}:
        rest = set()
        for run in grid.runs:
            if run.group == group:
                values = run.config.to_mapping()
                rest.add(str({k: v for k, v in values.items() if k not in ("advice", "seed")}))
        assert len(rest) == 1, group


def test_the_shipped_grid_of_stages_has_method_ablations_and_baselines() -> None:
    grid = read_grid(CONFIGS / "constraints.yml")
    by_row = {run.row: run.config for run in grid.runs}
    stages = {row: [one.stage for one in config.stages or ()] for row, config in by_row.items()}
    assert stages["min"] == ["teaching", "stretching", "exploring"]
    assert stages["own value, no stretching"] == ["teaching", "exploring"]
    assert stages["advising without the third stage"] == ["teaching", "stretching"]
    assert stages["hindsight alone"] == ["exploring"]
    assert by_row["hindsight alone"].advice is None
    assert by_row["min"].constraint_relabelling == "next"
    assert by_row["own value"].constraint_relabelling == "keep"
    assert by_row["own value"].per_arm_critics
    assert by_row["min, eight layers"].net_arch == (512, 512, *(256,) * 6)
