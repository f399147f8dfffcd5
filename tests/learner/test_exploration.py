"""Uniform actions that are held for several steps."""

from __future__ import annotations

import json

import numpy as np
import pytest

from saver_advisors.learner.exploration import HeldActions

OWN = 2.0  # outside [-1, 1]: no random action equals it


def played(held: HeldActions, steps: int, n_explorers: int = 1, seed: int = 0) -> np.ndarray:
    """The actions (steps, 50 environments, 4) of a student whose own action is `OWN`."""
    random = np.random.default_rng(seed)
    own = np.full((50, 4), OWN)
    return np.stack([held.replace(own, random, n_explorers) for _ in range(steps)])


def lengths(series: np.ndarray) -> list[int]:
    """How long each random action in the series of one environment was held."""
    changes = np.flatnonzero(np.diff(series)) + 1
    parts = np.split(series, changes)[1:-1]  # the first and the last may be cut
    return [len(part) for part in parts if part[0] != OWN]


@pytest.mark.parametrize(("fraction", "steps"), [(0.3, 8), (0.2, 1), (0.6, 3)])
def test_fraction_and_length_are_those_asked_for(fraction: float, steps: int) -> None:
    actions = played(HeldActions(fraction, steps), 4_000)
    assert np.mean(actions[100:] != OWN) == pytest.approx(fraction, rel=0.04)
    held = [length for env in range(50) for length in lengths(actions[:, env, 0])]
    assert np.mean(held) == pytest.approx(steps, rel=0.04)
    assert max(held) == 2 * steps - 1 and min(held) == 1
    # All of an action is held together.
    assert ((actions != OWN).all(axis=2) | (actions == OWN).all(axis=2)).all()


def test_environments_and_arms_explore_independently() -> None:
    random = played(HeldActions(0.3, 8), 4_000, n_explorers=2) != OWN
    first, second, other = random[:, :, 0], random[:, :, 2], random[:, [*range(1, 50), 0], 0]
    assert (random[:, :, 1] == first).all() and (random[:, :, 3] == second).all()
    assert np.mean(first & second) == pytest.approx(0.09, rel=0.1)
    assert np.mean(first & other) == pytest.approx(0.09, rel=0.1)


def test_none_and_all() -> None:
    assert (played(HeldActions(0.0, 8), 100) == OWN).all()
    assert (played(HeldActions(1.0, 8), 100) != OWN).all()


def test_a_restored_state_continues() -> None:
    whole = played(HeldActions(0.3, 8), 40)
    random = np.random.default_rng(0)
    own = np.full((50, 4), OWN)
    before, after = HeldActions(0.3, 8), HeldActions(0.3, 8)
    after.load_state_dict(before.state_dict())  # before the first action
    for step in range(17):
        np.testing.assert_array_equal(before.replace(own, random), whole[step])
    after.load_state_dict(json.loads(json.dumps(before.state_dict())))
    for step in range(17, 40):
        np.testing.assert_array_equal(after.replace(own, random), whole[step])


@pytest.mark.parametrize(
    ("fraction", "steps", "message"),
    [(1.5, 8, "random_action_probability=1.5"), (0.3, 0, "random_action_steps=0")],
)
def test_arguments_out_of_range(fraction: float, steps: int, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        HeldActions(fraction, steps)
