"""The teacher begins each episode and the student ends it; the teacher's part shrinks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from stable_baselines3 import TD3
from stable_baselines3.common.vec_env import DummyVecEnv
from test_advised_algorithms import make_model
from test_advisor import observation, students
from toy_arms import ToyArms, make_teacher, make_vec_env
from toy_runs import (
    BLOCK,
    HORIZON,
    advisor_state,
    assert_resumes_exactly,
    replay,
    save_teacher,
    settings,
)

from saver_advisors.advising import AdvisingCallback, build_advised, make_advisor
from saver_advisors.advising.context import AdviceBudget
from saver_advisors.advising.strategies import JumpStart


def advice(folder: Path, **more: Any) -> dict[str, Any]:
    return {"strategy": "jump-start", "teacher": save_teacher(folder), "budget": 10**6, **more}


def spent(total: int, used: int) -> AdviceBudget:
    budget = AdviceBudget(total)
    budget.load_state_dict({"total": total, "spent": used})
    return budget


@hypothesis_settings(deadline=None, max_examples=40)
@given(st.integers(1, 60), st.integers(1, 12), st.integers(12, 300))
def test_each_stage_gets_its_share_of_the_budget(horizon: int, stages: int, total: int) -> None:
    strategy = make_advisor(
        "jump-start",
        make_teacher(),
        total,
        n_arms=2,
        horizon=horizon,
        settings={"stages": stages},
    ).strategy
    assert isinstance(strategy, JumpStart)
    steps = [strategy.teacher_steps(spent(total, used)) for used in range(total)]
    assert steps[0] == horizon
    assert steps == sorted(steps, reverse=True)
    assert min(steps) >= 1
    for stage in range(stages):
        first = -(-stage * total // stages)
        assert steps[first] == -(-horizon * (stages - stage) // stages)


def test_the_first_steps_of_an_episode_are_the_teachers() -> None:
    advisor = make_advisor(JumpStart(stages=2, horizon=10), make_teacher(), 100, n_arms=2)

    def advised() -> list[bool]:
        steps = np.array([0, 4, 5, 9])
        mask = advisor.advise(observation(4), students(4), episode_steps=steps).mask
        return [bool(row.all()) for row in mask]

    assert advised() == [True] * 4
    advisor.budget.load_state_dict({"spent": 50})
    assert advised() == [True, True, False, False]


def test_the_students_success_shortens_it_and_never_lengthens_it() -> None:
    strategy = JumpStart(stages=3, success=0.9, horizon=9)
    make_advisor(strategy, make_teacher(), 100, n_arms=2)
    seen = []
    for rate in (0.0, 0.29, 0.3, 0.0, 0.6, 0.95, 0.1):
        strategy.student_evaluated(rate)
        seen.append(strategy.teacher_steps(spent(100, 60)))
    assert seen == [9, 9, 6, 6, 3, 0, 0]


def test_the_clock_begins_with_each_learn_that_resets() -> None:
    """Episodes of 10 steps, of which 4 are the teacher's."""
    advisor = make_advisor(JumpStart(stages=1, horizon=4), make_teacher(), 10**6, n_arms=2)
    model = make_model(TD3, make_vec_env(3))
    callback = AdvisingCallback(advisor)
    model.learn(3 * 16, callback=callback)
    flags = np.array(model.replay_buffer.advised)
    pattern = ([True] * 4 + [False] * 6) * 4
    assert flags.tolist() == [[flag] * 3 for flag in pattern[:16]]
    model.learn(3 * 8, callback=callback)
    flags = np.array(model.replay_buffer.advised)
    assert flags[16:].tolist() == [[flag] * 3 for flag in pattern[:8]]


def test_each_environment_has_a_clock_of_its_own() -> None:
    """It follows `done`, not the horizon: one environment's episodes end after 5 steps."""
    advisor = make_advisor(JumpStart(stages=1, horizon=3), make_teacher(), 10**6, n_arms=2)
    env = DummyVecEnv([lambda: ToyArms(horizon=10), lambda: ToyArms(horizon=5)])
    model = make_model(build_advised(TD3), env, advisor=advisor)
    model.learn(2 * 8)
    model.learn(2 * 12, reset_num_timesteps=False)
    flags = np.array(model.replay_buffer.advised)
    assert flags[:, 0].tolist() == ([True] * 3 + [False] * 7) * 2
    assert flags[:, 1].tolist() == ([True] * 3 + [False] * 2) * 4


def test_a_run_by_the_budget_resumes(tmp_path: Path) -> None:
    config = settings(advice(tmp_path, budget=2 * BLOCK, settings={"stages": 4}))
    assert_resumes_exactly(config, tmp_path)
    flags = replay(tmp_path / "whole")["advised"]
    lengths = flags.sum(axis=1)
    # In the order of the episodes the teacher's part shrinks to nothing.
    assert lengths[0] > HORIZON // 2
    assert (np.diff(lengths) <= 1).all()
    assert lengths[-1] == 0
    assert flags.sum() == 2 * BLOCK
    first_steps = np.sort(flags, axis=1)[:, ::-1]
    np.testing.assert_array_equal(first_steps, flags)


def test_a_run_by_success_resumes(tmp_path: Path) -> None:
    config = settings(advice(tmp_path, settings={"stages": 3, "success": 1.0}), eval_episodes=3)
    rates = [0.0, 1 / 3, 0.0, 2 / 3, 1.0, 0.0]
    assert_resumes_exactly(config, tmp_path, rates=rates)
    lengths = replay(tmp_path / "parts")["advised"].sum(axis=1).reshape(6, -1)
    # An evaluation decides about the block after it.
    expected = [[n] * 4 for n in (10, 10, 7, 7, 4, 0)]
    assert lengths.tolist() == expected
    assert advisor_state(tmp_path / "parts")["strategy_state"] == {"reached": 3}


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"stages": 0}, "stages=0"),
        ({"stages": 1.5}, "stages=1.5"),
        ({"stages": True}, "stages=True"),
        ({"horizon": 0}, "horizon=0"),
        ({"success": 0.0}, r"success=0.0 must be in \(0, 1\]"),
        ({"success": 1.1}, "success=1.1"),
        ({"success": float("nan")}, "success=nan"),
        ({"stage": 3}, "'jump-start' takes no stage=3; its settings are stages, success, horizon"),
    ],
)
def test_senseless_settings_are_refused(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        make_advisor("jump-start", make_teacher(), 1, n_arms=2, settings=wrong, horizon=10)


def test_it_has_to_know_the_episodes() -> None:
    with pytest.raises(ValueError, match="give horizon"):
        make_advisor("jump-start", make_teacher(), 1, n_arms=2)
    advisor = make_advisor("jump-start", make_teacher(), 1, n_arms=2, horizon=10)
    with pytest.raises(ValueError, match="pass episode_steps"):
        advisor.advise(observation(1), students(1))
