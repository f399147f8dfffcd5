"""Random times: how many, when, and the same again after a resume."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from test_advisor import observation, students
from toy_arms import make_teacher
from toy_runs import (
    BLOCK,
    BLOCKS,
    advisor_state,
    assert_resumes_exactly,
    curve,
    replay,
    save_teacher,
    start,
)
from toy_runs import settings as run_settings

from saver_advisors.advising import Advisor, make_advisor
from saver_advisors.advising.strategies import RandomAdvising


def times(advisor: Advisor, steps: int, n_envs: int = 1) -> np.ndarray:
    """(steps,) whether each environment step was advised; all arms of one together."""
    masks = []
    for _ in range(steps // n_envs):
        mask = advisor.advise(observation(n_envs), students(n_envs)).mask
        np.testing.assert_array_equal(mask[:, 0], mask[:, 1])
        masks.append(mask[:, 0])
    return np.concatenate(masks)


@hypothesis_settings(deadline=None, max_examples=25)
@given(st.integers(0, 60), st.integers(1, 6), st.integers(0, 5))
def test_the_budget_is_spent_to_the_last_step_of_the_run(
    budget: int, n_envs: int, seed: int
) -> None:
    total = 48 // n_envs * n_envs
    advisor = make_advisor("random", make_teacher(), budget, n_arms=2, total_steps=total, seed=seed)
    assert times(advisor, total, n_envs).sum() == min(budget, total) == advisor.spent


def test_it_is_spread_over_the_whole_run() -> None:
    advisor = make_advisor("random", make_teacher(), 200, n_arms=2, total_steps=2000)
    advised = times(advisor, 2000, 4).reshape(4, 500).sum(axis=1)
    # Without replacement: 50 in each quarter, give or take three standard deviations.
    assert (np.abs(advised - 50) < 3 * 6).all()


def test_a_probability_spends_sooner() -> None:
    advisor = make_advisor(
        "random", make_teacher(), 100, n_arms=2, settings={"probability": 0.5, "seed": 3}
    )
    advised = times(advisor, 400)
    assert advised.sum() == 100
    assert 150 < np.flatnonzero(advised)[-1] < 260
    assert 60 < advised[:160].sum() < 100


def test_seeds_make_the_times() -> None:
    def of(**named: int) -> list[bool]:
        arguments = {"total_steps": 100, **named}
        advisor = make_advisor("random", make_teacher(), 30, n_arms=2, **arguments)
        return times(advisor, 100).tolist()

    assert of(seed=1) == of(seed=1) != of(seed=2)
    assert make_advisor(RandomAdvising(0.5), make_teacher(), 1, n_arms=2).strategy.settings == {
        "probability": 0.5,
        "seed": None,
    }


@pytest.mark.parametrize("wrong", [0, 0.0, -0.1, 1.5, float("nan"), "0.1", True])
def test_senseless_probabilities_are_refused(wrong: object) -> None:
    with pytest.raises((TypeError, ValueError), match="probability="):
        make_advisor("random", make_teacher(), 1, n_arms=2, settings={"probability": wrong})


def test_it_has_to_know_how_often() -> None:
    with pytest.raises(ValueError, match=r"give total_steps, or settings=\{'probability': 0.1\}"):
        make_advisor("random", make_teacher(), 1, n_arms=2)
    with pytest.raises(ValueError, match="seed=-1"):
        RandomAdvising(0.1, seed=-1)


@pytest.mark.parametrize("probability", [None, 0.3])
def test_a_resumed_run_is_advised_at_the_same_times(
    tmp_path: Path, probability: float | None
) -> None:
    advice = {
        "strategy": "random",
        "teacher": save_teacher(tmp_path),
        "budget": 2 * BLOCK + 3,
        "settings": {"probability": probability},
    }
    config = run_settings(advice)
    assert_resumes_exactly(config, tmp_path)
    spent = [line["advice_spent"] for line in curve(tmp_path / "whole")]
    assert spent[-1] == 2 * BLOCK + 3
    assert 0 < spent[0] < BLOCK
    assert replay(tmp_path / "whole")["advised"].sum() == 2 * BLOCK + 3
    if probability is None:
        # A third of each block, to the end.
        assert np.diff([0, *spent]).min() > 5
    assert advisor_state(tmp_path / "parts")["transitions"] == BLOCKS * BLOCK


def test_a_state_without_the_generator_is_refused() -> None:
    advisor = make_advisor("random", make_teacher(), 1, n_arms=2, total_steps=10)
    state = advisor.state_dict() | {"strategy_state": None}
    with pytest.raises(ValueError, match="no strategy_state"):
        advisor.load_state_dict(state)


def test_a_run_in_yaml_takes_its_length_from_itself(tmp_path: Path) -> None:
    advice = {"strategy": "random", "teacher": save_teacher(tmp_path), "budget": 10**6}
    start(run_settings(advice, total_steps=BLOCK), tmp_path / "run")
    # A budget beyond the run: every step is advised.
    assert replay(tmp_path / "run")["advised"].all()
