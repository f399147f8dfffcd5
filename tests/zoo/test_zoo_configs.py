"""The settings files: every id, in RL Zoo's format, accepted by the classes that they are for."""

from __future__ import annotations

import argparse
import importlib
from pathlib import Path
from typing import Any

import pytest
import yaml
from rl_zoo3 import ALGOS
from rl_zoo3.utils import get_callback_list
from stable_baselines3 import HerReplayBuffer
from zoo_runs import CONFIGS

from saver_advisors.experiments.grid import ExperimentRun, read_grid
from saver_advisors.experiments.recorder import BenchmarkPlan
from saver_advisors.learner import GoalReplayBuffer
from saver_advisors.training.defaults import default_settings
from saver_advisors.training.settings import RunConfig
from saver_advisors.variable_reward import ConstraintReplayBuffer, StagesCallback, TrainingStage
from saver_advisors.zoo.algorithms import ALGORITHMS, register_algorithms
from saver_advisors.zoo.arguments import read_settings, ready_advice, settings_path
from saver_advisors.zoo.manager import SaverExperimentManager
from saver_advisors.zoo.vec_env import BatchedVecEnv
from saver_envs.registration import make_episodes

IDS = (
    "JacoPush-v0",
    "JacoPickAndPlace-v0",
    "DualJacoPush-v0",
    "DualJacoPickAndPlace-v0",
    "DualJacoDistance-v0",
)
STOCK = ("ddpg", "td3", "sac", "tqc")


def baselines() -> list[ExperimentRun]:
    """The first seed of each baseline of other libraries."""
    runs = read_grid(CONFIGS / "baselines.yml").runs
    return [run for run in runs if isinstance(run.config, BenchmarkPlan) and run.config.seed == 0]


def build(algorithm: str, env_id: str, folder: Path) -> Any:
    """The model that RL Zoo makes of a file, before any step."""
    register_algorithms()

    class Manager(SaverExperimentManager):
        default_vec_env_cls = BatchedVecEnv

    manager = Manager(
        argparse.Namespace(),
        algorithm,
        env_id,
        str(folder),
        config=str(settings_path(algorithm)),
        eval_freq=-1,
        device="cpu",
        verbose=0,
    )
    model, _ = manager.setup_experiment() or (None, None)
    return model


OWN_FILE = ("goal_dagger", "goal_td3")
BUILT = [(name, env_id) for name in (*STOCK, *OWN_FILE) for env_id in IDS]
# The others have their settings from the same files: one of them each.
BUILT += [(name, "DualJacoPickAndPlace-v0") for name in ALGORITHMS if name not in OWN_FILE]


@pytest.mark.parametrize(("algorithm", "env_id"), BUILT)
def test_rl_zoo_builds_every_algorithm_for_every_id(
    algorithm: str, env_id: str, tmp_path: Path
) -> None:
    model = build(algorithm, env_id, tmp_path)
    stock = algorithm in STOCK
    assert type(model) is (ALGOS[algorithm] if stock else ALGORITHMS[algorithm])
    expected = GoalReplayBuffer if algorithm.startswith("goal") else HerReplayBuffer
    if (algorithm, env_id) == ("goal_td3", "DualJacoDistance-v0"):
        expected = ConstraintReplayBuffer
        assert model.policy.critic_target.value_bounds == pytest.approx((-100.0, 0.0))
    assert type(model.replay_buffer) is expected
    assert model.n_envs == (64 if algorithm == "goal_dagger" else 16)
    assert model.gamma == 0.98
    # A transition's later goals are known only when its episode is over.
    if stock:
        assert model.learning_starts > 50 * model.n_envs
    model.env.close()


@pytest.mark.parametrize("name", [*STOCK, "goal", *OWN_FILE])
def test_advice_is_names_and_numbers_and_fits_the_arms(name: str) -> None:
    content = yaml.safe_load((CONFIGS / f"{name}.yml").read_text())
    for env_id, advice in content["advice"].items():
        assert {type(value) for value in advice.values()} <= {str, int, float, bool}
        assert ready_advice(advice, env_id, {}, 1000, 0)["horizon"] == 50


@pytest.mark.parametrize("env_id", IDS)
def test_the_goal_learner_has_the_settings_of_saver_train(env_id: str) -> None:
    """One learner, one set of numbers, in two formats."""
    entry, advice = read_settings(settings_path("goal_td3"), env_id)
    compare(entry, advice, RunConfig.from_mapping(default_settings(env_id)))


def test_the_stages_have_the_settings_of_the_method_as_written() -> None:
    entry, advice = read_settings(CONFIGS / "stages.yml", "DualJacoDistance-v0")
    grid = read_grid(CONFIGS / "constraints.yml")
    [run] = grid.only(["distance-min-seed0"]).runs
    compare(entry, advice, run.config)


@pytest.mark.parametrize("run", baselines(), ids=lambda run: f"{run.config.env_id} {run.row}")
def test_a_baseline_has_the_settings_of_rl_zoo(run: ExperimentRun) -> None:
    """A baseline can be run again either way."""
    plan = run.config
    assert isinstance(plan, BenchmarkPlan)
    module, _, name = plan.algorithm.partition(":")
    entry, _ = read_settings(settings_path(name.lower()), plan.env_id)
    assert ALGOS[name.lower()] is getattr(importlib.import_module(module), name)
    same = dict(entry)
    assert same.pop("policy") == "MultiInputPolicy"
    assert same.pop("n_timesteps") == plan.total_steps
    assert same.pop("n_envs") == plan.n_envs
    assert same.pop("noise_type", "normal") == "normal"
    del same["monitor_kwargs"]
    contested = {"contested_share": 0.4}  # the default, which the grid says once more
    training = {**contested, **plan.train_env_kwargs}
    assert {**contested, **same.pop("env_kwargs", {})} == training
    if "replay_buffer_class" in same:
        same["replay_buffer_class"] = f"import:stable_baselines3:{same['replay_buffer_class']}"
    assert same == plan.algo_kwargs


def compare(entry: dict[str, Any], advice: dict[str, Any] | None, config: RunConfig) -> None:
    """An entry of RL Zoo's says what a configuration of ours does."""
    same = [
        "n_envs",
        "gradient_steps",
        "learning_starts",
        "buffer_size",
        "batch_size",
        "learning_rate",
        "gamma",
        "tau",
        "policy_delay",
        "target_policy_noise",
        "target_noise_clip",
        "exploration_noise",
        "random_action_probability",
    ]
    assert {name: entry[name] for name in same} == {name: getattr(config, name) for name in same}
    optional = {"random_action_steps": 1, "contact_cost": 0.0, "imitation_weight": 0.0}
    for name, usual in optional.items():
        assert entry.get(name, usual) == getattr(config, name)
    assert (entry["policy"] == "SharedArmsPolicy") == config.shared_arms
    assert entry["n_timesteps"] == config.total_steps
    policy = entry["policy_kwargs"]
    assert tuple(policy["net_arch"]) == config.net_arch
    assert (policy["layer_norm"], policy["action_penalty"]) == (
        config.layer_norm,
        config.action_penalty,
    )
    replay = entry["replay_buffer_kwargs"]
    assert replay["relabel_probability"] == config.relabel_probability
    assert ("goal_parts" in replay) == config.per_arm_critics
    assert policy.get("n_values", 1) == len(replay.get("goal_parts", [1]))
    assert sum(replay.get("goal_parts", [])) in (0, make_episodes(config.env_id).goal_size)
    contested = {"contested_share": 0.4}  # the default, which saver.yml says once more
    training = {**contested, **config.env_kwargs, **config.train_env_kwargs}
    assert {**contested, **entry.get("env_kwargs", {})} == training
    read = policy.get("features_extractor_kwargs", {}).get("achieved_goal", False)
    assert read == config.achieved_goal_input
    compare_constraint(entry, config)
    if config.advice is None:
        assert advice is None
        return
    assert advice is not None
    own = ("strategy", "teacher", "budget", "warm_start")
    assert {"warm_start": False, **advice} == {name: getattr(config.advice, name) for name in own}


def compare_constraint(entry: dict[str, Any], config: RunConfig) -> None:
    """What becomes of a constraint, and in which stages."""
    relabelling = entry["replay_buffer_kwargs"].get("constraint_relabelling")
    assert relabelling == config.constraint_relabelling
    kept = {"saver_advisors.variable_reward.ConstraintReplayBuffer"} if relabelling else {None}
    assert {entry.get("replay_buffer_class")} == kept
    callbacks = get_callback_list(entry)
    assert len(callbacks) == (config.stages is not None)
    if config.stages is not None:
        (callback,) = callbacks
        assert isinstance(callback, StagesCallback)
        assert callback.stages == tuple(
            TrainingStage.parse(one.stage, one.until) for one in config.stages
        )
        assert callback.constraint_value_weight == config.constraint_value_weight
