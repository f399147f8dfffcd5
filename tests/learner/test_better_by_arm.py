"""Which arms take a proposed action: against a search over everything."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from saver_advisors.learner.imitation import better_by_arm

BATCH, SIZE = 5, 2


def critic(seed: int, n_arms: int, n_values: int) -> Any:
    """Random quadratic values of all arms' actions, another for each row of the batch."""
    random = np.random.default_rng(seed)
    matrix = random.normal(size=(BATCH, n_values, n_arms * SIZE, n_arms * SIZE))
    asked: list[int] = []

    def values(actions: Any) -> Any:
        asked.append(len(actions))
        return np.einsum("kbi,bvij,kbj->kbv", actions, matrix, actions).astype(np.float32)

    values.asked = asked  # type: ignore[attr-defined]
    return values


def actions(seed: int, n_arms: int) -> tuple[Any, Any]:
    random = np.random.default_rng(seed + 1)
    own, proposed = random.uniform(-1, 1, (2, BATCH, n_arms, SIZE)).astype(np.float32)
    return own, proposed


def mix(mask: Any, own: Any, proposed: Any) -> Any:
    return np.where(np.asarray(mask)[..., None], proposed, own).reshape(BATCH, -1)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 1000), st.integers(1, 4), st.data())
def test_one_value_chooses_among_all_combinations(seed: int, n_arms: int, data: Any) -> None:
    arms = np.array(data.draw(st.lists(st.booleans(), min_size=n_arms, max_size=n_arms)))
    own, proposed = actions(seed, n_arms)
    values = critic(seed, n_arms, 1)
    chosen = better_by_arm(own, proposed, values, arms)
    assert not chosen[:, ~arms].any()
    assert sum(values.asked) == 2 ** arms.sum()
    best = values(mix(chosen, own, proposed)[None])[0, :, 0]
    for combination in itertools.product(*((False, True) if arm else (False,) for arm in arms)):
        mask = np.tile(combination, (BATCH, 1))
        assert (values(mix(mask, own, proposed)[None])[0, :, 0] <= best + 1e-4).all()


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 1000), st.integers(2, 4), st.integers(0, 1), st.data())
def test_a_value_an_arm_asks_each_arm_by_itself(
    seed: int, n_arms: int, shared: int, data: Any
) -> None:
    arms = np.array(data.draw(st.lists(st.booleans(), min_size=n_arms, max_size=n_arms)))
    own, proposed = actions(seed, n_arms)
    values = critic(seed, n_arms, n_arms + shared)
    chosen = better_by_arm(own, proposed, values, arms)
    assert sum(values.asked) == 1 + arms.sum()
    before = values(own.reshape(1, BATCH, -1))[0]
    for arm in range(n_arms):
        mask = np.zeros((BATCH, n_arms), bool)
        mask[:, arm] = True
        gain = values(mix(mask, own, proposed)[None])[0] - before
        of_arm = gain[:, arm] + gain[:, n_arms:].sum(axis=1)
        np.testing.assert_array_equal(chosen[:, arm], (of_arm > 0) & arms[arm])


def test_a_tie_is_left_to_the_own_action() -> None:
    own, proposed = actions(0, 2)
    for n_values in (1, 2):

        def values(asked: Any, n: int = n_values) -> Any:
            return np.zeros((*asked.shape[:2], n), np.float32)

        assert not better_by_arm(own, proposed, values, np.ones(2, bool)).any()


def test_a_number_of_values_that_means_nothing_is_refused() -> None:
    own, proposed = actions(0, 3)
    with pytest.raises(ValueError, match="gives 2 values for 3 arms"):
        better_by_arm(own, proposed, critic(0, 3, 2), np.ones(3, bool))
