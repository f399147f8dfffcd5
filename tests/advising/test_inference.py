import numpy as np
import pytest
import torch

from saver_advisors.policies.inference import FrozenPolicy
from saver_advisors.policies.networks import ACTIVATIONS, NetworkSpec, PolicyNetworks
from saver_advisors.policies.teacher import Teacher

INPUTS = (("observation", 5), ("desired_goal", 2))


def make_networks(activation: str, layer_norm: bool, outputs: int = 1) -> PolicyNetworks:
    spec = NetworkSpec(INPUTS, 3, (16, 12), (10, 9), 2, outputs, activation, layer_norm, layer_norm)
    with torch.random.fork_rng():
        torch.manual_seed(3)
        networks = PolicyNetworks(spec)
        for name, value in networks.state_dict().items():
            if name not in ("clip", "std", "action_low", "action_high"):
                value.copy_(0.7 * torch.randn_like(value))
        networks.std.uniform_(0.5, 2.0)
        networks.clip[:4] = 1.0
        networks.action_low.copy_(torch.tensor([-1.0, -2.0, 0.0]))
        networks.action_high.copy_(torch.tensor([1.0, 0.5, 4.0]))
    return networks


def rows(seed: int, *shape: int):
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32)


@pytest.mark.parametrize("layer_norm", [False, True])
@pytest.mark.parametrize("activation", sorted(ACTIVATIONS))
def test_numpy_computes_what_the_torch_modules_compute(activation, layer_norm):
    networks = make_networks(activation, layer_norm, outputs=4)
    policy = FrozenPolicy(networks)
    inputs = {"observation": rows(0, 40, 5), "desired_goal": rows(1, 40, 2)}
    with torch.inference_mode():
        flat = torch.from_numpy(np.concatenate(list(inputs.values()), axis=1))
        features = ((flat - networks.mean) / networks.std).clamp(-networks.clip, networks.clip)
        low, high = networks.action_low, networks.action_high
        action = low + 0.5 * (torch.tanh(networks.actor(features)) + 1.0) * (high - low)
        given = low + torch.rand(40, 3) * (high - low)
        joined = torch.cat([features, 2.0 * (given - low) / (high - low) - 1.0], dim=1)
        first, second = (critic(joined).mean(dim=1) for critic in networks.critics)
    got = policy.features(inputs)
    np.testing.assert_allclose(got, features, atol=1e-6)
    np.testing.assert_allclose(policy.action(got), action, atol=1e-5)
    least = policy.q_value(got, given.numpy(), twin_minimum=True)
    np.testing.assert_allclose(least, torch.minimum(first, second), atol=1e-4)
    alone = policy.q_value(got, given.numpy(), twin_minimum=False)
    np.testing.assert_allclose(alone, first, atol=1e-4)
    assert np.abs(alone - least).max() > 0.01
    assert {values.dtype for values in (got, policy.action(got), least)} == {np.dtype(np.float32)}


def test_features_are_left_as_they_are():
    policy = FrozenPolicy(make_networks("relu", True))
    features = rows(2, 8, 7)
    kept = features.copy()
    policy.action(features)
    policy.q_value(features, rows(3, 8, 3), twin_minimum=True)
    np.testing.assert_array_equal(features, kept)


def test_no_rows_give_no_actions_and_no_values():
    policy = FrozenPolicy(make_networks("relu", True))
    empty = policy.features({key: np.zeros((0, size)) for key, size in INPUTS})
    assert policy.action(empty).shape == (0, 3)
    assert policy.q_value(empty, rows(0, 0, 3), twin_minimum=True).shape == (0,)


def test_changing_the_weights_later_changes_no_teacher():
    networks = make_networks("relu", False)
    teacher = Teacher(networks)
    state = rows(0, 6, 5), rows(1, 6, 2)
    before = teacher.act(*state)
    for value in networks.state_dict().values():
        value.fill_(0.3)
    np.testing.assert_array_equal(teacher.act(*state), before)
    assert np.abs(Teacher(networks).act(*state) - before).max() > 0.01
