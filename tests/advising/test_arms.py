"""Which arms are advised, by whom, and how many there may be."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_advisor import observation, students
from tiny_runs import read_config, write_settings
from toy_arms import ACTION, make_teacher
from toy_runs import BLOCK, advisor_state, settings, start, steps_taken
from toy_runs import save_teacher as save

from saver_advisors.advising import build_advised, make_advisor
from saver_advisors.learner import GoalTD3
from saver_advisors.pretrained import load_teacher, side_by_side
from saver_envs.envs.sb3_vec_env import SaverVecEnv


@pytest.mark.parametrize("strategy", ["early", "random", "mc-act"])
def test_arms_that_may_not_be_advised_are_left_alone(strategy: str) -> None:
    advisor = make_advisor(strategy, make_teacher(), 100, n_arms=2, arms=[1], total_steps=6)
    own = students(6)
    advice = advisor.advise(observation(6), own)
    assert not advice.mask[:, 0].any()
    assert advice.mask[:, 1].any()
    np.testing.assert_array_equal(advice.actions[:, :ACTION], own[:, :ACTION])
    # A step is paid for once, and only where somebody was advised.
    assert advisor.spent == int(advice.mask[:, 1].sum())


@pytest.mark.parametrize("arms", [[], [2], [-1], [0.0], [True]])
def test_arms_that_do_not_exist_are_refused(arms: list[int]) -> None:
    with pytest.raises(ValueError, match=r"must be one or more of \[0, 1\]"):
        make_advisor("early", make_teacher(), 10, n_arms=2, arms=arms)


def test_a_run_advises_some_arms_by_teachers_of_their_own(tmp_path: Path) -> None:
    left, right = save(tmp_path, 1, "left"), save(tmp_path, 2, "right")
    advice = {
        "strategy": "mc-q",
        "teacher": [left, right],
        "budget": 1000,
        "threshold": 0.0,
        "arms": [1],
        "twin_minimum": False,
        "compare": "noise-free",
    }
    config = settings(advice)
    assert config.advice is not None
    assert config.advice.teacher == (left, right)
    write_settings(config, tmp_path / "run.yaml")
    assert read_config(tmp_path / "run.yaml") == config
    start(config, tmp_path / "run")
    state = advisor_state(tmp_path / "run")
    assert state["teachers"] == ["left", "right"]
    assert (state["twin_minimum"], state["compare"], state["arms"]) == (False, "noise-free", [1])
    assert state["advised_per_arm"][0] == 0 < state["advised_per_arm"][1]


@pytest.mark.parametrize("n_arms", [3, 4])
def test_one_teacher_advises_any_number_of_arms(n_arms: int) -> None:
    """The shipped teacher of one arm, in the scene of three and of four."""
    env = SaverVecEnv("DualJacoPush-v0", n_envs=2, seed=0, n_arms=n_arms, max_episode_steps=6)
    spaces = {"observation_space": env.observation_space, "action_space": env.action_space}
    advisor = make_advisor("early", "jaco-push", 2 * 6, **spaces)
    assert advisor.mapping.n_arms == n_arms
    model = build_advised(GoalTD3)(
        "MultiInputPolicy",
        env,
        advisor=advisor,
        buffer_size=100,
        policy_kwargs={"net_arch": [8], "n_values": n_arms},
        replay_buffer_kwargs={"goal_parts": (3,) * n_arms},
        learning_starts=0,
        train_freq=6,
        gradient_steps=2,
        batch_size=8,
        seed=0,
        device="cpu",
    ).learn(2 * 6)
    buffer = model.replay_buffer
    rows = {
        "observation": buffer.observation[:2, :6].reshape(12, -1),
        "achieved_goal": buffer.achieved_goal[:2, :6].reshape(12, -1),
        "desired_goal": np.repeat(buffer.desired_goal[:2], 6, axis=0),
    }
    expected, _ = side_by_side(load_teacher("jaco-push"), n_arms).predict(rows)
    # Gymnasium's box is [-1, 1] here, so that stored and executed are the same numbers.
    np.testing.assert_allclose(buffer.action[:2].reshape(12, -1), expected, atol=1e-5)
    assert advisor.advised_per_arm.tolist() == [12] * n_arms
    assert model._n_updates == 2


def test_a_foreign_number_of_teachers_is_refused_before_a_step(tmp_path: Path) -> None:
    path = save(tmp_path)
    envs: list[Any] = []
    with pytest.raises(ValueError, match="3 teachers for 2 arms"):
        start(
            settings({"strategy": "early", "teacher": [path] * 3, "budget": BLOCK}),
            tmp_path / "run",
            envs=envs,
        )
    assert steps_taken(envs[0]) == 0
