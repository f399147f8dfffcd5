"""The settings files under RL Zoo: every safe algorithm is built as its file says."""

from __future__ import annotations

import argparse
import importlib
from pathlib import Path

import pytest
import yaml
from rl_zoo3 import ALGOS
from rl_zoo3.exp_manager import ExperimentManager
from stable_baselines3.common.vec_env import VecEnv

from saver_advisors.cli import main
from saver_advisors.safe_baselines import ALGORITHMS, LagrangianMixin
from saver_advisors.zoo.algorithms import register_algorithms

CONFIGS = Path(__file__).parents[2] / "zoo_configs"
IDS = ("DualJacoDistance-v0", "DualJacoDistanceDense-v0")


@pytest.mark.parametrize("name", ALGORITHMS)
def test_rl_zoo_builds_what_the_file_says(name, tmp_path):
    import saver_envs  # noqa: F401  # registers the ids, as --gym-packages does

    register_algorithms()
    assert ALGOS[name] is ALGORITHMS[name]
    path = CONFIGS / f"{name}.yml"
    manager = ExperimentManager(
        argparse.Namespace(),
        name,
        IDS[0],
        str(tmp_path),
        config=str(path),
        eval_freq=-1,
        device="cpu",
        verbose=0,
        hyperparams={"n_envs": 2},
    )
    model, _ = manager.setup_experiment() or (None, None)
    entry = yaml.safe_load(path.read_text())[IDS[0]]
    assert type(model) is ALGORITHMS[name]
    for key in ("cost_limit", "cost_gamma", "cost_gae_lambda", "n_steps", "gamma", "target_kl"):
        assert getattr(model, key) == entry[key]
    if issubclass(ALGORITHMS[name], LagrangianMixin):
        assert model.multiplier_lr == entry["multiplier_lr"]
    assert isinstance(model.env, VecEnv)
    model.env.close()


@pytest.mark.parametrize("name", ALGORITHMS)
def test_both_rewards_have_an_entry_and_a_rollout_holds_whole_episodes(name):
    content = yaml.safe_load((CONFIGS / f"{name}.yml").read_text())
    for env_id in IDS:
        entry = content[env_id]
        assert entry["n_steps"] % 50 == 0
        assert (entry["n_steps"] * entry["n_envs"]) % entry["batch_size"] == 0


@pytest.mark.parametrize("name", ALGORITHMS)
def test_the_command_trains_by_the_file_and_leaves_a_model(name, tmp_path):
    words = ["train", "--zoo", name, "--env", IDS[0], "--output", str(tmp_path), "--steps", "40"]
    words += [
        "--env-kwargs",
        "max_episode_steps=10",
        "--set",
        "n_envs=2",
        "n_steps=10",
        "batch_size=10",
    ]
    assert main([*words, "--", "--eval-freq", "-1"]) == 0
    (saved,) = (tmp_path / name).glob(f"*/{IDS[0]}.zip")
    model = ALGORITHMS[name].load(saved, device="cpu")
    assert model.num_timesteps == 40
    assert model.cost_limit == 1.0


def test_what_learns_on_policy_is_not_advised(tmp_path, capsys):
    words = ["train", "--zoo", "cpo", "--env", IDS[0], "--output", str(tmp_path)]
    words += ["--advice", "early", "--teacher", "jaco-pick-and-place", "--budget", "10"]
    assert main(words) == 2
    assert "argument --advice: cpo learns on policy" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("algorithm", ALGORITHMS.values())
def test_a_module_and_a_class_name_are_enough(algorithm):
    """As commands that take MODULE:CLASS make one: policy, environment, seed."""
    from saver_envs.envs.sb3_vec_env import SaverVecEnv

    module, _, name = f"saver_advisors.safe_baselines:{algorithm.__name__}".partition(":")
    found = getattr(importlib.import_module(module), name)
    assert found is algorithm
    env = SaverVecEnv("JacoPush-v0", 1, seed=0)
    model = found("MultiInputPolicy", env, seed=0)
    assert model.predict(env.reset())[0].shape == (1, 3)
    env.close()
