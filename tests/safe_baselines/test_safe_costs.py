"""Advantages and sums of costs, against loops that follow the definitions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from saver_advisors.safe_baselines.costs import (
    CostRollout,
    EpisodeCosts,
    generalized_advantages,
    read_costs,
)


def naive_advantages(signal, values, last_values, starts, dones, gamma, lam):
    """The definition: discounted sums of one-step differences, up to the end of the episode."""
    steps, n_envs = signal.shape
    advantages = np.zeros((steps, n_envs))
    for env in range(n_envs):
        ends = [bool(starts[t + 1, env]) for t in range(steps - 1)] + [bool(dones[env])]
        following = [*values[1:, env], last_values[env]]
        for begin in range(steps):
            weight = 1.0
            for t in range(begin, steps):
                beyond = 0.0 if ends[t] else gamma * following[t]
                advantages[begin, env] += weight * (signal[t, env] + beyond - values[t, env])
                weight *= gamma * lam
                if ends[t]:
                    break
    return advantages


@settings(deadline=None, max_examples=60)
@given(
    seed=st.integers(0, 2**31),
    steps=st.integers(1, 12),
    n_envs=st.integers(1, 4),
    gamma=st.floats(0.1, 1.0),
    lam=st.floats(0.0, 1.0),
)
def test_advantages_are_those_of_the_definition(seed, steps, n_envs, gamma, lam):
    random = np.random.default_rng(seed)
    signal, values = random.normal(size=(2, steps, n_envs)).astype(np.float32)
    last = random.normal(size=n_envs).astype(np.float32)
    starts, dones = random.random((steps, n_envs)) < 0.3, random.random(n_envs) < 0.5
    found = generalized_advantages(signal, values, last, starts, dones, gamma, lam)
    expected = naive_advantages(signal, values, last, starts, dones, gamma, lam)
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_a_rollout_keeps_costs_values_and_starts_in_order():
    rollout = CostRollout(3, 2)
    for step in range(3):
        rollout.add(
            np.array([step, 10.0 + step]), np.array([0.5, 0.25]), np.array([step == 1, False])
        )
    rollout.finish(np.array([7.0, 9.0]), np.array([False, True]), gamma=1.0, gae_lambda=1.0)
    # With gamma = lambda = 1 the targets are sums of cost to the end, or to the last value.
    np.testing.assert_allclose(rollout.returns[:, 0], [0.0, 1 + 2 + 7, 2 + 7])
    np.testing.assert_allclose(rollout.returns[:, 1], [10 + 11 + 12, 11 + 12, 12])
    rollout.reset()
    assert rollout.position == 0


def test_sums_run_on_across_rollouts_and_leave_out_torn_episodes():
    episodes = EpisodeCosts(2)
    episodes.add(np.array([1.0, 5.0]), np.array([False, False]))
    episodes.add(np.array([2.0, 5.0]), np.array([True, False]))
    assert [list(one) for one in episodes.take()] == [[3.0], [2]]
    episodes.add(np.array([4.0, 5.0]), np.array([False, True]))
    assert [list(one) for one in episodes.take()] == [[15.0], [3]]
    episodes.interrupt()
    episodes.add(np.array([1.0, 1.0]), np.array([True, True]))
    assert [list(one) for one in episodes.take()] == [[], []]
    episodes.add(np.array([1.0, 1.0]), np.array([True, False]))
    assert [list(one) for one in episodes.take()] == [[1.0], [1]]
    episodes.restart()
    episodes.add(np.array([0.0, 2.0]), np.array([False, True]))
    assert [list(one) for one in episodes.take()] == [[2.0], [1]]


@pytest.mark.parametrize(
    ("info", "words"),
    [
        ({"is_success": False}, "no info\\['cost'\\]"),
        ({}, "nothing"),
        ({"cost": float("nan")}, "finite"),
        ({"cost": float("inf")}, "finite"),
        ({"cost": "much"}, "one number"),
        ({"cost": None}, "finite"),
        ({"cost": np.zeros(2)}, "one number"),
    ],
)
def test_a_cost_that_is_none_is_refused(info, words):
    with pytest.raises(ValueError, match=words) as caught:
        read_costs([{"cost": 1.0}, info], "cost")
    assert "environment 1" in str(caught.value)


def test_costs_of_any_number_type_are_read():
    infos = [{"cost": one} for one in (1, True, np.float32(0.5), np.array([2.0]), np.int64(3))]
    assert read_costs(infos, "cost").tolist() == [1.0, 1.0, 0.5, 2.0, 3.0]
