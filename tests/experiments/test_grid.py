"""Grids: what a file turns into, and what is wrong with one."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tiny_grids import GridFile, run_named, tiny_grid

from saver_advisors.cli import main
from saver_advisors.evaluation.protocol import (
    EVALUATE_EVERY,
    REPORT_EPISODES,
    SEEDS,
    off_protocol,
)
from saver_advisors.experiments.grid import ExperimentRun, Grid, check_rows, read_grid
from saver_advisors.experiments.recorder import BenchmarkPlan
from saver_advisors.experiments.results import read_result
from saver_advisors.experiments.training_runs import read_training_runs
from saver_advisors.experiments.worker import DONE, execute
from saver_advisors.training.defaults import default_settings
from saver_advisors.training.settings import RunConfig

ALGORITHMS = Path(__file__).resolve().parents[1] / "benchmarks" / "algorithms.py"
CONFIGS = Path(__file__).resolve().parents[2] / "zoo_configs"
#: The rows of the grid of constraints.
ROWS = {run.row: run for run in read_grid(CONFIGS / "constraints_shared_arms.yml").runs}


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
    with pytest.raises(ValueError, match="neither YAML nor JSON"):
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
    assert_groups_differ_in_advice_and_seed_alone(grid)


def test_the_grid_of_shared_arms_has_the_rows_of_the_table_and_five_seeds_of_push() -> None:
    grid = read_grid(CONFIGS / "advising_shared_arms.yml")
    seeds: dict[tuple[str, str], list[int]] = {}
    for run in grid.runs:
        seeds.setdefault((run.group, run.row), []).append(run.config.seed)
    table = {"none", "early", "early-mc", "mc-q 0.1", "mc-act 0.1", "mc-actabs 0.1"}
    for group, count in (("push", 5), ("pick-and-place", 3)):
        of_group = {row: given for (name, row), given in seeds.items() if name == group}
        assert of_group == {row: list(range(count)) for row in table}
    advised = [run.config for run in grid.runs if run.config.advice is not None]
    shares = [one.advice.budget / one.total_steps for one in advised if not one.advice.warm_start]
    assert {round(share, 4) for share in shares} == {0.2222, 1.0}
    assert_groups_differ_in_advice_and_seed_alone(grid)
    # The runs without advice are those of `saver train`.
    alone = next(run for run in grid.runs if run.name == "push-none-seed0").config
    default = RunConfig.from_mapping(default_settings("DualJacoPush-v0"))
    assert replace(default, checkpoint_every=alone.checkpoint_every) == alone


def assert_groups_differ_in_advice_and_seed_alone(grid: Grid) -> None:
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


def test_the_baselines_have_one_budget_and_five_seeds() -> None:
    grid = read_grid(CONFIGS / "baselines.yml")
    seeds: dict[tuple[str, str], list[int]] = {}
    for run in grid.runs:
        seeds.setdefault((run.config.env_id, run.row), []).append(run.config.seed)
        assert (run.config.total_steps, run.final_episodes) == (500_000, REPORT_EPISODES)
        assert (run.config.n_envs, run.config.env_kwargs) == (16, {})
        assert off_protocol(run.config.to_mapping(), {}) == ["no final episodes"]
    ids = ("JacoPush", "JacoPickAndPlace", "DualJacoPush", "DualJacoPickAndPlace")
    rows = ("SAC + HER", "TQC + HER", "TD3 + HER", "DDPG + HER", "SAVER TD3")
    expected = {(f"{name}-v0", row) for name in ids for row in rows}
    assert seeds.keys() == expected | {(f"{name}Dense-v0", "PPO") for name in ids}
    assert all(given == list(range(SEEDS)) for given in seeds.values())


def test_all_baselines_of_an_id_train_on_the_same_starts() -> None:
    options: dict[str, list[dict[str, Any]]] = {}
    for run in read_grid(CONFIGS / "baselines.yml").runs:
        env_id = run.config.env_id.replace("Dense", "")
        options.setdefault(env_id, []).append(dict(run.config.train_env_kwargs))
    assert all(one == given[0] for given in options.values() for one in given)


@pytest.mark.parametrize("group", ["push", "pick-and-place", "dual-push", "dual-pick-and-place"])
def test_our_baseline_is_saver_train(group: str) -> None:
    config = run_named(f"{group}-saver-td3-seed0", read_grid(CONFIGS / "baselines.yml")).config
    own = ("total_steps", "eval_every", "eval_episodes", "checkpoint_every")
    told = {**default_settings(config.env_id), **{name: getattr(config, name) for name in own}}
    assert config == RunConfig.from_mapping(told)
    # As many transitions per environment step as those of other libraries.
    drawn = config.gradient_steps * config.batch_size
    assert drawn / (config.n_envs * 50) == 0.15 * 256


def test_the_grid_of_constraints_has_five_seeds_and_one_limit_for_all() -> None:
    grid = read_grid(CONFIGS / "constraints_shared_arms.yml")
    seeds: dict[str, list[int]] = {}
    for run in grid.runs:
        seeds.setdefault(run.row, []).append(run.config.seed)
    assert set(map(tuple, seeds.values())) == {(0, 1, 2, 3, 4)}
    by_row = {run.row: run for run in grid.runs}
    written = by_row["min"].config
    assert isinstance(written, RunConfig) and written.stages is not None
    assert [one.stage for one in written.stages] == ["teaching", "stretching", "exploring"]
    assert written.constraint_relabelling == "next" and not written.per_arm_critics
    limits, started = {}, []
    for row, run in by_row.items():
        config = run.config
        if isinstance(config, BenchmarkPlan):
            limits[row] = config.algo_kwargs["cost_limit"]
            started.append(config.algo_kwargs["policy_kwargs"]["teacher"])
        elif config.cost_limit is not None:
            assert config.cost_key == "cost_distance"
            limits[row] = config.cost_limit
    assert len(started) == 3 and set(started) == {"jaco-pick-and-place"}
    common = {row: limit for row, limit in limits.items() if "limit" not in row}
    assert len(common) == 4 and set(common.values()) == {1.0}
    assert len(limits) == 6 and by_row["goal alone"].shield


@pytest.mark.slow
@pytest.mark.parametrize("row", sorted(ROWS))
def test_every_row_of_the_grid_of_constraints_runs(row: str, tmp_path: Path) -> None:
    """With its own settings, but for two environments and two episodes of ten steps in each."""
    run = ROWS[row]
    config: Any = run.config
    kwargs = {**config.env_kwargs, "max_episode_steps": 10}
    small = {"n_envs": 2, "total_steps": 40, "eval_every": 20, "eval_episodes": 2}
    if isinstance(config, BenchmarkPlan):
        algo_kwargs = {**config.algo_kwargs, "n_steps": 20, "batch_size": 20}
        config = replace(config, **small, env_kwargs=kwargs, algo_kwargs=algo_kwargs)
        config = replace(config, report_episodes=2)
    else:
        config = replace(config, **small, env_kwargs=kwargs, gradient_steps=2, learning_starts=0)
    run = replace(run, config=config, final_episodes=2)
    result = tmp_path / f"{run.name}.json"
    assert execute(run, tmp_path / "run", result) == DONE
    content = read_result(result)
    assert content["finished"] and content["curve"][-1]["training_cost"] >= 0
    assert set(content["final"]["cost_cvar"]) == set(content["final"]["cost_means"])
    assert (content.get("shielded") is not None) == run.shield
    assert read_training_runs([result]).runs[0].group == "shared-arms"


def with_row(row: dict[str, Any], **settings: Any) -> dict[str, Any]:
    """A tiny grid with one more row."""
    content = tiny_grid(**settings)
    content["groups"]["push"]["rows"]["more"] = row
    return content


def test_a_row_with_an_algorithm_of_ones_own(grid_file: GridFile) -> None:
    row = {"algorithm": f"{ALGORITHMS}:Drifter", "algo_kwargs": {"speed": 0.25}, "seeds": [4]}
    grid = read_grid(grid_file(with_row({**row, "settings": {"n_envs": 3}, "teacher_steps": 7})))
    run = run_named("push-more-seed4", grid)
    plan = run.config
    assert isinstance(plan, BenchmarkPlan)
    assert (plan.name, plan.row, plan.group) == ("push-more-seed4", "more", "push")
    assert (plan.seed, plan.n_envs, plan.total_steps, plan.eval_every) == (4, 3, 160, 40)
    assert (plan.env_kwargs, plan.algo_kwargs) == ({"max_episode_steps": 10}, {"speed": 0.25})
    assert (plan.report_episodes, plan.teacher_steps) == (2, 7)
    assert len(plan.source_sha256 or "") == 64
    assert ExperimentRun.from_mapping(run.to_mapping()) == run
    check_rows(grid.runs)


def test_a_third_party_row_follows_the_protocol_by_default(grid_file: GridFile) -> None:
    content = with_row({"algorithm": f"{ALGORITHMS}:Drifter"})
    del content["groups"]["push"]["settings"]["eval_every"]
    plan = run_named("push-more-seed0", read_grid(grid_file(content))).config
    assert plan.eval_every == EVALUATE_EVERY


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ({"shield": "yes"}, "shield='yes' must be true or false"),
        ({"shield": True}, "shield=true needs a task with a constraint"),
        ({"shield": True, "algorithm": "a:B"}, "shield=true needs our learner"),
        ({"algorithm": "td3"}, "algorithm='td3' must be MODULE:CLASS or FILE.py:CLASS"),
        ({"algorithm": "nowhere.py:A"}, "the file 'nowhere.py' does not exist"),
        ({"algorithm": "a:B", "settings": {"net_arch": [8]}}, "settings: unknown ['net_arch']"),
        ({"algorithm": "a:B", "settings": {"n_envs": "many"}}, "n_envs='many'"),
        ({"algorithm": "a:B", "algo_kwargs": 3}, "algo_kwargs must be a mapping"),
        ({"algorithm": "a:B", "teacher_steps": -1}, "teacher_steps=-1"),
    ],
)
def test_a_wrong_row_is_named(grid_file: GridFile, row: dict[str, Any], message: str) -> None:
    with pytest.raises((TypeError, ValueError)) as caught:
        read_grid(grid_file(with_row(row)))
    assert f"push.more: {message}" in str(caught.value)


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ({"settings": {"env_kwargs": {"n_arms": 9}}}, "env_kwargs: n_arms=9"),
        ({"settings": {"env_kwargs": {"speeed": 1}}}, "'speeed'"),
        ({"settings": {"env_kwargs": {"randomization": "wild"}}}, "randomization='wild': must be"),
        (
            {"settings": {"env_kwargs": {"randomization": {"object_mass": 0}}}},
            "must be within 0.001 to 100 kg",
        ),
        ({"advice": {"strategy": "early", "teacher": "nobody"}}, "policy 'nobody' is unknown"),
        ({"advice": {"strategy": "lately"}}, "'lately'"),
        ({"algorithm": "no.such.module:A"}, "'no.such.module' cannot be imported"),
        ({"algorithm": f"{ALGORITHMS}:Drift"}, "has no 'Drift'"),
        ({"algorithm": f"{ALGORITHMS}:Drifter", "algo_kwargs": {"a": "import:math:t"}}, "'t'"),
    ],
)
def test_all_rows_are_checked_before_the_first_run(
    grid_file: GridFile,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    row: dict[str, Any],
    message: str,
) -> None:
    output = tmp_path / "runs"
    words = ["experiments", "run", str(grid_file(with_row(row))), "--output", str(output)]
    assert main(words) == 2
    said = capsys.readouterr().err
    assert "argument GRID.yml: push.more: " in said
    assert message in said
    assert said.count("\n") == 1
    assert not output.exists(), "nothing was begun"


@pytest.mark.slow
def test_worlds_vary_in_a_grid(grid_file: GridFile, tmp_path: Path) -> None:
    """Its results have what differed in the evaluations of every run."""
    varied = {"object_size": [0.04, 0.09], "action_delay": {"choice": [0, 1]}}
    options = {"max_episode_steps": 10, "randomization": varied}
    content = tiny_grid(env_kwargs=options, total_steps=80)
    assert main(["experiments", "run", str(grid_file(content)), "--output", str(tmp_path)]) == 0
    found = [json.loads(path.read_text()) for path in (tmp_path / "results").glob("*.json")]
    found = [one for one in found if one.get("final")]
    assert len(found) == 3
    expected = {"object_size": {"uniform": [0.04, 0.09]}, "action_delay": {"choice": [0, 1]}}
    for one in found:
        assert one["config"]["env_kwargs"] == options
        assert one["final"]["randomization"] == expected


def test_no_module_is_imported_before_all_other_rows_fit(
    grid_file: GridFile, tmp_path: Path
) -> None:
    (tmp_path / "own.py").write_text("raise SystemExit('imported')")
    content = with_row({"algorithm": f"{tmp_path / 'own.py'}:A"})
    content["groups"]["push"]["rows"]["none"] = {"settings": {"env_kwargs": {"n_arms": 9}}}
    grid = read_grid(grid_file(content))
    with pytest.raises(ValueError, match=r"push.none: .*n_arms=9"):
        check_rows(sorted(grid.runs, key=lambda run: run.row, reverse=True))
