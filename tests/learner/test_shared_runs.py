"""Runs of `saver train` with shared arms, held actions and a multiplier, from start to export."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th
from safetensors.torch import load_file
from tiny_runs import TINY_RUN, write_settings

from saver_advisors.cli import main as saver
from saver_advisors.evaluation.episodes import curve_point
from saver_advisors.learner.policies import SETTLED_COUNT
from saver_advisors.policies.files import load_policy, load_teacher
from saver_advisors.training.curve_file import OF_THE_MACHINE, read_curve
from saver_advisors.training.launch import load_trained, train
from saver_advisors.training.release import release_run
from saver_advisors.training.settings import AdviceConfig, RunConfig
from saver_envs.envs.sb3_vec_env import SaverVecEnv

CONFIG = replace(
    TINY_RUN,
    env_id="DualJacoPush-v0",
    total_steps=160,
    shared_arms=True,
    gradient_steps=4,
    random_action_probability=0.5,
    random_action_steps=8,
    contact_cost=0.5,
    cost_limit=0.1,
    checkpoint_every=40,
    eval_every=40,
)


def states(folder: Path) -> dict[str, Any]:
    """The checkpoint's counters and generators, without what differs between equal runs."""
    state = json.loads((folder / "latest" / "state.json").read_text())
    del state["extra"]["wall_clock_s"], state["extra"]["processor_s"], state["sha256"]
    # The order of a header's entries differs.
    return {**state, "files": sorted(state["files"])}


def test_a_resumed_run_equals_an_uninterrupted_one(tmp_path: Path) -> None:
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    train(CONFIG, whole, progress=False)
    train(CONFIG, parts, progress=False, stop_after_steps=80)
    left = states(parts)["random"]["held_actions"]["left"]
    assert np.shape(left) == (2, 2) and np.any(left)  # in the middle of a random action
    train(CONFIG, parts, progress=False, resume=True)
    assert states(whole) == states(parts)
    with np.load(whole / "latest/replay.npz") as a, np.load(parts / "latest/replay.npz") as b:
        assert "cost" in a
        for name in a:
            np.testing.assert_array_equal(a[name], b[name], err_msg=name)
    for name in ("policy.safetensors", "training.safetensors"):
        one, other = (load_file(folder / "latest" / name) for folder in (whole, parts))
        assert one.keys() == other.keys()
        assert all(th.equal(tensor, other[key]) for key, tensor in one.items())
        # Buffers of the multiplier are among them.
        assert "multiplier/value" in one or name != "training.safetensors"
    points = [
        [{k: v for k, v in point.items() if k not in OF_THE_MACHINE} for point in read_curve(one)]
        for one in (whole, parts)
    ]
    assert points[0] == points[1]
    assert {"episode_cost", "cost_multiplier", "safe_success_rate"} <= points[0][-1].keys()


def test_its_policy_is_evaluated_and_exported(tmp_path: Path) -> None:
    path, run = tmp_path / "shared.yml", tmp_path / "run"
    write_settings(replace(CONFIG, total_steps=80), path)
    assert saver(["train", "--config", str(path), "--output", str(run), "--no-progress"]) == 0
    weights = tmp_path / "shared.safetensors"
    assert saver(["export", str(run), "--path", str(weights), "--episodes", "2"]) == 0
    evaluate = ["evaluate", "--env", "DualJacoPush-v0", "--episodes", "2", "--policy"]
    for policy in (weights, run):
        words = [*evaluate, str(policy), "--env-kwargs", "max_episode_steps=5"]
        assert saver(words) == 0
    model = load_trained(run, "best")
    observation = SaverVecEnv("DualJacoPush-v0", n_envs=5, seed=3).reset()
    expected, _ = model.predict(observation, deterministic=True)
    from_run = load_teacher(run)
    for found in (
        load_policy(weights).predict(observation)[0],
        from_run.act(observation["observation"], observation["desired_goal"]),
    ):
        np.testing.assert_allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize("strategy", ["none", "mc-act", "ibrl"])
def test_shared_arms_start_from_and_are_advised_by_a_teacher(strategy: str, tmp_path: Path) -> None:
    advice = AdviceConfig(strategy, "jaco-push", 40, warm_start=True, bootstrap=strategy == "ibrl")
    config = replace(CONFIG, advice=advice, net_arch=(128, 128, 128))
    result = train(config, tmp_path, progress=False)
    assert result.finished
    spent = read_curve(tmp_path)[-1]["advice_spent"]
    assert spent == 0 if strategy == "none" else spent > 0


def test_three_arms_start_as_two(tmp_path: Path) -> None:
    two, three = tmp_path / "two", tmp_path / "three"
    train(replace(CONFIG, total_steps=40), two, progress=False)
    more = {**CONFIG.env_kwargs, "n_arms": 3}
    config = replace(CONFIG, total_steps=40, env_kwargs=more, start_from=str(two))
    assert train(config, three, progress=False, stop_after_steps=0).steps == 0
    start = load_file(two / "best" / "policy.safetensors")
    begun = load_file(three / "latest" / "policy.safetensors")
    assert start.keys() == begun.keys()
    # The statistics are kept, as if from any number of samples.
    kept = [name for name in begun if not name.endswith((".count", ".squared_deviation"))]
    assert all(th.equal(begun[name], start[name]) for name in kept)
    assert (begun["shared_features.count"] == SETTLED_COUNT).all()
    shutil.rmtree(two)  # a resumed run no longer needs it
    assert train(config, three, progress=False, resume=True).finished
    card = three / "policy.safetensors"
    release_run(three, card, episodes=2)
    assert load_policy(card).card.notes["config"]["start_from"] == "two"
    ended = load_file(three / "latest" / "policy.safetensors")
    for name in ("shift", "scale"):
        then, now = (one[f"shared_features.{name}"] for one in (start, ended))
        np.testing.assert_allclose(now, then, rtol=1e-4, atol=1e-5)
    with pytest.raises(FileNotFoundError, match="two"):
        train(config, tmp_path / "other", progress=False)
    assert not list((tmp_path / "other").glob("*.json*"))
    wider = replace(config, net_arch=(16,), start_from=str(three))
    with pytest.raises(ValueError, match=r"start_from: .*does not fit this policy"):
        train(wider, tmp_path / "other", progress=False)


def test_a_distance_is_shared_by_the_arms(tmp_path: Path) -> None:
    """The goal's last part belongs to both, and has a value of its own in each arm's network."""
    config = replace(
        CONFIG,
        env_id="DualJacoDistance-v0",
        total_steps=80,
        constraint_relabelling="keep",
        achieved_goal_input=True,
    )
    assert train(config, tmp_path, progress=False).finished
    model = load_trained(tmp_path, "latest")
    assert model.critic.reward_columns == (0, 1, 2, 2, 3, 3)
    observation = SaverVecEnv("DualJacoDistance-v0", n_envs=5, seed=3).reset()
    assert load_teacher(tmp_path).networks.spec.sizes["achieved_goal"] == 7
    assert np.isfinite(model.predict(observation)[0]).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"shared_arms": True, "algorithm": "sac"}, "shared_arms=True needs algorithm='td3' or"),
        ({"contact_cost": 0.5, "algorithm": "tqc"}, "contact_cost=0.5 needs algorithm='td3'"),
        ({"cost_limit": 0.0, "algorithm": "ddpg"}, "cost_limit=0.0 needs algorithm='td3'"),
        ({"cost_limit": -1.0}, "cost_limit=-1.0 must be 0 or more"),
        ({"random_action_steps": 0}, "random_action_steps=0 must be positive"),
        ({"team_rewards": True}, "team_rewards=True must be false unless shared_arms"),
    ],
)
def test_settings_that_do_not_fit_are_named(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        RunConfig.from_mapping({"env_id": "DualJacoPush-v0", **changes})


@pytest.mark.parametrize(("costs", "best"), [(True, 80), (False, 120)])
def test_the_best_policy_is_safe_where_contact_costs(
    costs: bool, best: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = iter([(0.8, 0.2), (0.9, 0.8), (1.0, 0.5), (0.9, 0.7)])

    def evaluated(result: dict[str, Any]) -> dict[str, Any]:
        success, safe = next(found)
        return {**curve_point(result), "success_rate": success, "safe_success_rate": safe}

    monkeypatch.setattr("saver_advisors.training.run.curve_point", evaluated)
    free = {} if costs else {"contact_cost": 0.0, "cost_limit": None}
    train(replace(CONFIG, **free), tmp_path, progress=False)
    assert json.loads((tmp_path / "best" / "evaluation.json").read_text())["steps"] == best
