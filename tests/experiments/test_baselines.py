"""The grid of baselines: every row of another library trains, with the stated number of updates."""

from __future__ import annotations

import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from saver_advisors.experiments.grid import ExperimentRun, check_rows, read_grid
from saver_advisors.experiments.recorder import BenchmarkPlan, Recorder
from saver_advisors.experiments.third_party import load_class, train

CONFIGS = Path(__file__).resolve().parents[2] / "zoo_configs"
RATIO = 0.15
"""Gradient steps per environment step."""


def first_seeds(*grids: str) -> list[ExperimentRun]:
    """One run of each row of another library."""
    runs = [run for name in grids for run in read_grid(CONFIGS / f"{name}.yml").runs]
    return [run for run in runs if isinstance(run.config, BenchmarkPlan) and run.config.seed == 0]


BASELINES, IN_JAX = first_seeds("baselines"), first_seeds("baselines_sbx")


def trained(plan: BenchmarkPlan, folder: Path, steps: int) -> tuple[Any, dict[str, Any]]:
    """Train a row by the protocol for some steps; return the model of SB3 and the record."""
    models = []
    algorithm = load_class(plan.algorithm)

    class Kept(algorithm):  # type: ignore[misc, valid-type]
        def learn(self, *args: Any, **kwargs: Any) -> Any:
            models.append(self)
            return super().learn(*args, **kwargs)

    short = replace(plan, total_steps=steps, eval_episodes=1, report_episodes=1)
    record = train(Kept, Recorder(short, folder))
    (model,) = models
    return model, record


def test_every_row_can_be_built() -> None:
    check_rows(read_grid(CONFIGS / "baselines.yml").only(["seed0"]).runs)


@pytest.mark.parametrize("run", IN_JAX, ids=lambda run: run.name)
def test_baselines_in_jax_have_the_settings_of_the_others(run: ExperimentRun) -> None:
    group = f"{run.group}-tqc-her-seed0"
    (other,) = [one.config for one in BASELINES if one.name == group]
    assert isinstance(run.config, BenchmarkPlan) and isinstance(other, BenchmarkPlan)
    without = {"tau"} if run.config.algorithm == "sbx:CrossQ" else set()
    wanted = {name: value for name, value in other.algo_kwargs.items() if name not in without}
    assert run.config.algo_kwargs == wanted
    labels = ("name", "row", "algorithm", "algo_kwargs")
    same = {name: getattr(other, name) for name in labels}
    assert replace(run.config, **same) == other


@pytest.mark.slow
@pytest.mark.parametrize("run", [*BASELINES, *IN_JAX], ids=lambda run: run.name)
def test_every_row_learns_as_often_as_the_file_says(run: ExperimentRun, tmp_path: Path) -> None:
    assert isinstance(run.config, BenchmarkPlan)
    if run.config.algorithm.startswith("sbx:"):
        pytest.importorskip("sbx")
    block, given = 50 * run.config.n_envs, copy.deepcopy(run.config.algo_kwargs)
    # The first two blocks only fill the replay; after the last one the budget is spent.
    model, record = trained(run.config, tmp_path, 4 * block)
    assert record["finished"]
    assert record["curve"][-1]["steps"] == model.num_timesteps == 4 * block
    assert record["curve"][-1]["processor_s"] > 0
    assert record["config"]["algo_kwargs"] == given, "SB3 changes its arguments"
    if run.row == "PPO":
        assert model.n_steps == 250
        return
    assert (model.train_freq.frequency, model.train_freq.unit.value) == (50, "step")
    assert model.learning_starts == 2 * block
    assert model.gradient_steps == RATIO * block
    assert model._n_updates == RATIO * block
    stored = model.replay_buffer
    assert type(stored).__name__ == "HerReplayBuffer"
    assert stored.her_ratio == 0.8


def test_training_starts_are_not_those_of_evaluations(tmp_path: Path) -> None:
    """Options for training alone reach neither the evaluations nor the digest of the world."""
    run = next(one for one in BASELINES if one.name == "pick-and-place-sac-her-seed0")
    assert isinstance(run.config, BenchmarkPlan)
    model, record = trained(run.config, tmp_path, 16)
    assert model.env.unwrapped.episodes.task.in_hand_probability == 0.4
    assert record["config"]["train_env_kwargs"] == {"in_hand_probability": 0.4}
    assert record["config"]["env_kwargs"] == {}
    assert record["world"] == record["final"]["world"]
