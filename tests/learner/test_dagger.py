"""DAgger: a student imitates its teachers in the states that it visits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th
from safetensors.torch import load_file
from stable_baselines3.common.vec_env import DummyVecEnv
from tiny_runs import TINY_RUN

from saver_advisors.cli.curves import draw, read_run
from saver_advisors.learner import GoalDAgger, GoalTD3
from saver_advisors.policies.files import load_teacher, save_policy
from saver_advisors.policies.freezing import networks_from_sb3
from saver_advisors.training.curve_file import read_curve
from saver_advisors.training.launch import load_trained, train
from saver_advisors.training.settings import AdviceConfig, RunConfig
from saver_envs.experts import make_expert
from tests.learner.conftest import PointReach, before_resets

CONFIG = replace(
    TINY_RUN,
    env_id="DualJacoPush-v0",
    algorithm="dagger",
    shared_arms=True,
    total_steps=80,
    checkpoint_every=40,
    advice=AdviceConfig("dagger", "expert", 60),
)


def learner(known: float, algorithm: Any = GoalDAgger, **arguments: Any) -> Any:
    """A learner with a replay whose labels are (0.6, -0.4), as far as they are known."""
    env = DummyVecEnv([PointReach for _ in range(2)])
    model = algorithm(
        "MultiInputPolicy",
        env,
        buffer_size=2_000,
        policy_kwargs={"net_arch": [32, 32]},
        learning_rate=3e-3,
        seed=0,
        device="cpu",
        **arguments,
    )
    model._setup_learn(100, None)
    random, observation = np.random.default_rng(0), env.reset()
    for _ in range(100):
        action = random.uniform(-1.0, 1.0, (2, 2)).astype(np.float32)
        after, reward, done, infos = env.step(action)
        following = before_resets(after, done, infos)
        infos = [
            {**info, "label": np.array([0.6, -0.4])} if random.random() < known else info
            for info in infos
        ]
        model.replay_buffer.add(observation, following, action, reward, done, infos)  # type: ignore[arg-type]
        observation = after
    return model


@pytest.mark.parametrize("known", [1.0, 0.3])
def test_the_actor_learns_the_labels_that_are_known(known: float) -> None:
    model = learner(known)
    model.train(200, 64)
    observation = model.env.reset()
    action, _ = model.predict(observation, deterministic=True)
    np.testing.assert_allclose(model.policy.scale_action(action), [[0.6, -0.4]] * 2, atol=0.05)


def test_without_labels_nothing_is_learned() -> None:
    model = learner(0.0)
    before = [parameter.clone() for parameter in model.policy.parameters()]
    model.train(20, 64)
    assert model._n_updates == 0
    assert all(map(th.equal, before, model.policy.parameters()))


@pytest.mark.parametrize("known", [1.0, 0.3, 0.0])
def test_td3_weighs_labels_against_its_values(known: float) -> None:
    models = []
    for weight in (0.0, 1e4):
        stored = {"labels": True}
        model = learner(known, GoalTD3, imitation_weight=weight, replay_buffer_kwargs=stored)
        model.train(200, 64)
        models.append(model)
    free, bound = models
    actions = [model.predict(bound.env.reset(), deterministic=True)[0] for model in (free, bound)]
    if known > 0:
        wanted = [[0.6, -0.4]] * 2
        np.testing.assert_allclose(bound.policy.scale_action(actions[1]), wanted, atol=0.05)
        assert not np.allclose(actions[0], actions[1], atol=0.1)
    else:
        assert all(map(th.equal, free.policy.parameters(), bound.policy.parameters()))


def test_labels_count_in_states_with_the_goals_of_their_episodes() -> None:
    model = learner(0.5)
    drawn = model.replay_buffer.sample_transitions(64)
    assert (drawn.desired_goal != drawn.episode_goal).any()
    seen, wanted = model.replay_buffer.labelled(drawn)
    known = np.isfinite(drawn.label).all(axis=1)
    assert 0 < len(wanted) == known.sum() < 64
    np.testing.assert_array_equal(seen["desired_goal"], drawn.episode_goal[known])
    np.testing.assert_array_equal(seen["observation"], drawn.observation[known])


def test_a_run_of_td3_with_labels_learns_values_as_well(tmp_path: Path) -> None:
    labelled = replace(CONFIG, algorithm="td3", imitation_weight=5.0)
    train(labelled, tmp_path, progress=False)
    assert read_curve(tmp_path)[-1]["advice_spent"] == 60
    assert read_curve(tmp_path)[-1]["mean_q"] is not None
    with np.load(tmp_path / "latest" / "replay.npz") as stored:
        assert np.isfinite(stored["label"]).all(axis=2).sum() == 60
    alone = replace(labelled, env_id="JacoPush-v0")
    train(alone, tmp_path / "alone", progress=False)
    assert networks_from_sb3(load_trained(tmp_path / "alone", "latest")).spec.n_critics == 2


def test_a_run_stores_what_the_expert_would_do(tmp_path: Path) -> None:
    train(CONFIG, tmp_path, progress=False)
    assert read_curve(tmp_path)[-1]["advice_spent"] == 60
    assert read_curve(tmp_path)[-1]["mean_q"] is None
    labels = [axes.get_ylabel() for axes in draw([read_run(tmp_path, "run")]).axes]
    assert [label for label in labels if label] == ["success rate", "collisions per episode"]
    with np.load(tmp_path / "latest" / "replay.npz") as stored:
        labels, actions, advised = stored["label"], stored["action"], stored["advised"]
        seen, goals = stored["observation"], stored["desired_goal"]
    # Two environments, so 30 steps of each: three episodes of ten.
    labelled = np.isfinite(labels).all(axis=2)
    np.testing.assert_array_equal(labelled, np.repeat([True, False], (6, 2))[:, None] & labelled)
    assert labelled.sum() == 60 and not advised.any()
    assert not np.allclose(labels[labelled], actions[labelled], atol=0.1)
    expert = make_expert("DualJacoPush-v0", max_episode_steps=10)
    for pair in ([0, 1], [2, 3], [4, 5]):
        for step in range(10):
            shown = {"observation": seen[pair, step], "desired_goal": goals[pair]}
            np.testing.assert_allclose(labels[pair, step], expert.predict(shown)[0], atol=1e-6)


def test_a_resumed_run_equals_an_uninterrupted_one(tmp_path: Path) -> None:
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    train(CONFIG, whole, progress=False)
    train(CONFIG, parts, progress=False, stop_after_steps=40)
    train(CONFIG, parts, progress=False, resume=True)
    one, other = (load_file(folder / "latest" / "policy.safetensors") for folder in (whole, parts))
    assert one.keys() == other.keys()
    assert all(th.equal(tensor, other[key]) for key, tensor in one.items())


@pytest.mark.parametrize("env_id", ["JacoPush-v0", "DualJacoPush-v0"])
@pytest.mark.parametrize("shared", [True, False])
def test_its_policy_ships_without_critics(env_id: str, shared: bool, tmp_path: Path) -> None:
    train(replace(CONFIG, env_id=env_id, shared_arms=shared), tmp_path / "run", progress=False)
    model = load_trained(tmp_path / "run", "latest")
    networks = networks_from_sb3(model)
    assert networks.spec.n_critics == 0
    card = {"env_id": env_id, "algorithm": "dagger", "command": "-", "steps": 80, "seed": 0}
    card |= {"wall_clock_s": 1.0, "commit": "-", "success": 0.0}
    path = save_policy(tmp_path / "mine.safetensors", networks, card)
    model.save(tmp_path / "mine.zip")
    observation = model.env.reset()
    expected, _ = model.predict(observation, deterministic=True)
    for source in (path, tmp_path / "run", tmp_path / "mine.zip"):
        teacher = load_teacher(source)
        assert not teacher.has_critics
        found = teacher.act(observation["observation"], observation["desired_goal"])
        if source != tmp_path / "run":  # whose best policy it reads
            np.testing.assert_allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"algorithm": "dagger", "advice": {"strategy": "none", "teacher": "a", "budget": 0}},
            "algorithm='dagger' and advice.strategy='none': it imitates labels",
        ),
        (
            {"advice": {"strategy": "dagger", "teacher": "expert", "budget": 1}},
            "advice.strategy='dagger' and algorithm='td3': labels need",
        ),
        (
            {"advice": {"strategy": "ibrl", "teacher": "expert", "budget": 1, "bootstrap": True}},
            "advice.bootstrap=True must be false with the teacher 'expert'",
        ),
        ({"algorithm": "sac", "shared_arms": True}, "shared_arms=True needs algorithm='td3' or"),
    ],
)
def test_settings_that_do_not_fit_are_named(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        RunConfig.from_mapping({"env_id": "DualJacoPush-v0", **changes})


def test_it_needs_a_teacher(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="algorithm='dagger' needs advice"):
        train(replace(CONFIG, advice=None), tmp_path, progress=False)
