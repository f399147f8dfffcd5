"""The policies: normaliser, bounds, penalty, and that SB3's save and load carry them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from hypothesis import given, settings
from hypothesis import strategies as st
from stable_baselines3.common.utils import ConstantSchedule
from torch import nn

from saver_advisors.learner import (
    GoalDDPG,
    GoalSAC,
    GoalTD3,
    GoalTQC,
    NormalizedGoalFeatures,
)
from saver_advisors.learner.policies import (
    GoalPolicyMixin,
    GoalSACPolicy,
    GoalTD3Policy,
    GoalTQCPolicy,
    conservative_values,
)

SPACE = spaces.Dict(
    {
        "observation": spaces.Box(-np.inf, np.inf, (3,), np.float32),
        "achieved_goal": spaces.Box(-np.inf, np.inf, (2,), np.float32),
        "desired_goal": spaces.Box(-np.inf, np.inf, (2,), np.float32),
    }
)
ACTION_SPACE = spaces.Box(-1.0, 1.0, (2,), np.float32)
POLICIES = [GoalTD3Policy, GoalSACPolicy, GoalTQCPolicy]
LEARNERS: list[Any] = [GoalDDPG, GoalTD3, GoalSAC, GoalTQC]


def make_policy(cls: type[GoalPolicyMixin] = GoalTD3Policy, **arguments: Any) -> GoalPolicyMixin:
    arguments = {"net_arch": [16, 16]} | arguments
    return cls(SPACE, ACTION_SPACE, ConstantSchedule(1e-3), **arguments)


def batch(n: int = 8, seed: int = 0, scale: float = 1.0) -> dict[str, th.Tensor]:
    generator = th.Generator().manual_seed(seed)
    return {
        key: scale * th.randn((n, space.shape[0]), generator=generator)
        for key, space in SPACE.items()
        if space.shape is not None
    }


def make_learner(cls: Any, env: Any, **arguments: Any) -> Any:
    defaults = {
        "buffer_size": 400,
        "batch_size": 16,
        "gamma": 0.9,
        "train_freq": 10,
        "gradient_steps": 4,
        "learning_starts": 0,
        "exploration_noise": 0.2,
        "seed": 0,
        "policy_kwargs": {"net_arch": [16]},
    }
    return cls("MultiInputPolicy", env, **(defaults | arguments))


# Normaliser --------------------------------------------------------------------------------------


@settings(max_examples=50, deadline=None)
@given(st.lists(st.integers(0, 7), min_size=1, max_size=6), st.integers(0, 999))
def test_statistics_in_pieces_are_those_of_the_whole(sizes: list[int], seed: int) -> None:
    random = np.random.default_rng(seed)
    offset, spread = random.uniform(-1e3, 1e3, 5), 10 ** random.uniform(-1, 3, 5)
    pieces = [offset + spread * random.standard_normal((size, 5)) for size in [*sizes, 1]]
    features = NormalizedGoalFeatures(SPACE)
    for piece in pieces:
        features.update({"observation": piece[:, :3], "desired_goal": piece[:, 3:]})
    whole = np.concatenate(pieces)
    assert (features.count == len(whole)).all()
    np.testing.assert_allclose(features.mean.numpy(), whole.mean(0), rtol=1e-9)
    np.testing.assert_allclose(features.shift.numpy(), whole.mean(0), rtol=1e-5)
    deviation = np.maximum(whole.std(0), 0.01)
    np.testing.assert_allclose(1 / features.scale.numpy(), deviation, rtol=1e-5)


def test_features_are_normalised_clipped_and_without_the_achieved_goal() -> None:
    features = NormalizedGoalFeatures(SPACE, clip=3.0)
    samples = {key: value.numpy() * 4 + 7 for key, value in batch(500).items()}
    features.update(samples)
    inputs = {key: th.as_tensor(value) for key, value in samples.items()}
    kept = {key: value.clone() for key, value in inputs.items()}
    output = features(inputs)
    joined = np.concatenate((samples["observation"], samples["desired_goal"]), axis=1)
    expected = np.clip((joined - joined.mean(0)) / joined.std(0), -3, 3)
    np.testing.assert_allclose(output.numpy(), expected, atol=1e-4)
    assert features.features_dim == 5
    inputs["achieved_goal"] += 1e6
    assert th.equal(features(inputs), output)
    assert th.equal(inputs["observation"], kept["observation"])
    assert features({**inputs, "observation": inputs["observation"] + 1e6}).max() == 3.0


def test_the_achieved_goal_is_read_where_it_is_asked_for() -> None:
    features = NormalizedGoalFeatures(SPACE, achieved_goal=True)
    samples = {key: value.numpy() * 4 + 7 for key, value in batch(500).items()}
    features.update(samples)
    output = features({key: th.as_tensor(value) for key, value in samples.items()}).numpy()
    achieved = samples["achieved_goal"]
    assert features.features_dim == output.shape[1] == 5 + achieved.shape[1]
    expected = (achieved - achieved.mean(0)) / achieved.std(0)
    np.testing.assert_allclose(output[:, 5:], expected, atol=1e-4)


def test_values_that_are_not_finite_are_refused_and_change_nothing() -> None:
    features = NormalizedGoalFeatures(SPACE)
    bad = {"observation": np.full((2, 3), np.nan), "desired_goal": np.zeros((2, 2))}
    with pytest.raises(ValueError, match="finite"):
        features.update(bad)
    assert (features.count == 0).all()


@pytest.mark.parametrize("name", ["clip", "minimum_standard_deviation"])
def test_normaliser_arguments_are_named(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name}=0"):
        NormalizedGoalFeatures(SPACE, **{name: 0})


@pytest.mark.parametrize("learner", LEARNERS)
def test_training_keeps_the_statistics_and_all_networks_share_them(
    learner: Any, make_env: Any
) -> None:
    model = make_learner(learner, make_env(2))
    model.learn(60)
    policy = model.policy
    networks = [getattr(policy, name, None) for name in ("actor", "actor_target", "critic")]
    extractors = [n.features_extractor for n in (*networks, policy.critic_target) if n is not None]
    # SB3 blends "running_" buffers into the targets; a shared one would become zero.
    before = policy.shared_features.mean.clone()
    assert before.abs().sum() > 0
    model.train(3, 16)
    for extractor in extractors:
        assert extractor is policy.shared_features
        assert th.equal(extractor.mean, before)


# Bounds and penalty ------------------------------------------------------------------------------


@pytest.mark.parametrize("cls", POLICIES)
def test_only_the_target_critic_is_bounded(cls: type[GoalPolicyMixin]) -> None:
    policy = make_policy(cls, q_min=-10.0, q_max=0.0)
    for network in (policy.critic, policy.critic_target):
        for q_network in network.q_networks:
            with th.no_grad():
                q_network[-1].weight.mul_(1000)
    actions = th.zeros(64, 2)
    bounded = policy.critic_target(batch(64), actions)
    free = policy.critic(batch(64), actions)
    bounded = th.cat(bounded, 1) if isinstance(bounded, tuple) else bounded
    free = th.cat(free, 1) if isinstance(free, tuple) else free
    assert bounded.min() == -10.0
    assert bounded.max() == 0.0
    assert th.equal(free.clamp(-10, 0), bounded)
    assert free.min() < -20
    assert free.max() > 20


@pytest.mark.parametrize("cls", POLICIES)
def test_without_bounds_the_target_equals_the_critic(cls: type[GoalPolicyMixin]) -> None:
    policy = make_policy(cls)
    actions = th.ones(8, 2)
    for one, other in zip(
        policy.critic(batch(), actions), policy.critic_target(batch(), actions), strict=True
    ):
        assert th.equal(one, other)


def test_the_actor_pays_for_its_actions_and_the_critic_records_nothing() -> None:
    policy = make_policy(action_penalty=0.3)
    plain = make_policy()
    plain.load_state_dict(policy.state_dict())
    actions = th.linspace(-1, 1, 16).reshape(8, 2).requires_grad_()
    value = policy.critic.q1_forward(batch(), actions)
    expected = plain.critic(batch(), actions)[0] - 0.3 * actions.square().mean(1, keepdim=True)
    assert th.allclose(value, expected)
    (gradient,) = th.autograd.grad(expected.sum(), actions)
    value.sum().backward()
    assert actions.grad is not None
    assert th.allclose(actions.grad, gradient)
    assert all(parameter.grad is None for parameter in policy.critic.parameters())
    assert all(parameter.requires_grad for parameter in policy.critic.parameters())


@pytest.mark.parametrize("cls", POLICIES)
@pytest.mark.parametrize("layer_norm", [True, False])
def test_layer_norm_follows_each_hidden_layer_of_the_critics(
    cls: type[GoalPolicyMixin], layer_norm: bool
) -> None:
    policy = make_policy(cls, layer_norm=layer_norm)
    wanted = [nn.Linear, nn.LayerNorm, nn.ReLU] if layer_norm else [nn.Linear, nn.ReLU]
    for network in policy.critic.q_networks:
        assert [type(module) for module in network] == [*wanted, *wanted, nn.Linear]
    assert len(policy.critic.q_networks) == 2


def test_policy_arguments_are_named() -> None:
    with pytest.raises(ValueError, match="q_min=1"):
        make_policy(q_min=1.0)
    with pytest.raises(ValueError, match="action_penalty=-1"):
        make_policy(action_penalty=-1.0)


@pytest.mark.parametrize("cls", POLICIES)
def test_student_value_is_the_conservative_estimate(cls: type[GoalPolicyMixin]) -> None:
    policy = make_policy(cls)
    values = policy.critic(batch(), th.ones(8, 2))
    if isinstance(values, tuple):
        expected = th.minimum(*values).squeeze(1)
    else:
        expected = values.reshape(8, -1).mean(1)
    assert th.allclose(conservative_values(policy.critic, batch(), th.ones(8, 2))[:, 0], expected)


# Saving ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("learner", LEARNERS)
def test_sb3_save_and_load_carry_everything(learner: Any, make_env: Any, tmp_path: Path) -> None:
    env = make_env(2)
    model = make_learner(learner, env, policy_kwargs={"net_arch": [16], "layer_norm": False})
    model.learn(60)
    model.save(tmp_path / "model.zip")
    observation = {key: value.numpy() for key, value in batch(scale=3.0).items()}
    expected, _ = model.predict(observation, deterministic=True)
    for loaded in (
        learner.load(tmp_path / "model.zip"),
        learner.load(tmp_path / "model.zip", env=env),
    ):
        action, _ = loaded.predict(observation, deterministic=True)
        np.testing.assert_array_equal(action, expected)
        assert loaded.policy.critic_target.value_bounds == pytest.approx((-10.0, 0.0))
        assert th.equal(loaded.policy.shared_features.mean, model.policy.shared_features.mean)
        assert loaded.exploration_noise == 0.2
    loaded.learn(40)
    assert loaded._n_updates > 0


@pytest.mark.parametrize("cls", POLICIES)
def test_a_policy_is_rebuilt_from_its_arguments(cls: type[GoalPolicyMixin]) -> None:
    policy = make_policy(cls, q_min=-5.0, layer_norm=False)
    policy.shared_features.update({key: value.numpy() + 3 for key, value in batch(50).items()})
    rebuilt = cls(**policy._get_constructor_parameters())
    rebuilt.load_state_dict(policy.state_dict())
    actions = [each._predict(batch(), deterministic=True) for each in (policy, rebuilt)]
    assert th.equal(*actions)
    assert rebuilt.critic_target.value_bounds == (-5.0, 0.0)
