"""Scripted experts as teachers: the same actions arm by arm, and what they cannot do."""

from __future__ import annotations

import numpy as np
import pytest

from saver_advisors.advising import make_advisor, warm_start_from_teachers
from saver_advisors.learner import GoalTD3
from saver_advisors.policies.scripted import scripted_teachers
from saver_envs.envs.sb3_vec_env import SaverVecEnv
from saver_envs.experts import make_expert


@pytest.mark.parametrize("env_id", ["DualJacoPush-v0", "DualJacoPickAndPlace-v0", "WristPush-v0"])
def test_arms_together_do_what_the_expert_does(env_id: str) -> None:
    env = SaverVecEnv(env_id, n_envs=3, seed=0)
    expert = make_expert(env_id, coordinated=False)
    advisor = make_advisor(
        "early",
        f"scripted:{env_id}",
        10_000,
        observation_space=env.observation_space,
        action_space=env.action_space,
    )
    observation = env.reset()
    for _ in range(8):
        expected, _ = expert.predict(observation)  # type: ignore[arg-type]
        advice = advisor.advise(observation, np.zeros_like(expected))
        np.testing.assert_allclose(advice.actions, expected, atol=1e-6)
        observation, *_ = env.step(expected)
    env.close()


@pytest.mark.parametrize("env_id", ["DualJacoDistance-v0", "DualJacoPush-v0", "WristPush-v0"])
def test_an_expert_labels_the_states_of_all_arms(env_id: str) -> None:
    env = SaverVecEnv(env_id, n_envs=3, seed=0)
    spaces = {"observation_space": env.observation_space, "action_space": env.action_space}
    advisor = make_advisor("dagger", make_expert(env_id), 14, **spaces)  # type: ignore[arg-type]
    expert, observation = make_expert(env_id), env.reset()
    for step in range(6):
        expected, _ = expert.predict(observation)  # type: ignore[arg-type]
        own = np.full_like(expected, 0.5)
        advice = advisor.advise(observation, own)
        assert advice.actions is own and not advice.mask.any()
        asked = max(0, min(3, 14 - 3 * step))
        if asked == 0:
            assert advisor.labels is None
            break
        assert advisor.labels is not None
        np.testing.assert_allclose(advisor.labels[:asked], expected[:asked], atol=1e-6)
        assert np.isnan(advisor.labels[asked:]).all()
        observation, *_ = env.step(expected)
    assert advisor.spent == 14
    env.close()


def test_one_arm_teaches_all_arms_of_a_student() -> None:
    [teacher] = scripted_teachers("scripted:JacoPush-v0")
    advisor = make_advisor("early", teacher, 100, n_arms=2)
    assert advisor.teachers.names == ["scripted:JacoPush-v0:0"] * 2


def test_what_a_script_cannot_do_is_refused() -> None:
    with pytest.raises(ValueError, match="has no critics: use 'early'"):
        make_advisor("mc-q", "scripted:DualJacoPush-v0", 100, n_arms=2, threshold=0.1)
    with pytest.raises(ValueError, match="carries with both arms as one"):
        scripted_teachers("scripted:DualJacoDistance-v0")
    with pytest.raises(ValueError, match="JacoPusch-v0"):
        scripted_teachers("scripted:JacoPusch-v0")
    with pytest.raises(ValueError, match=r"observation has shape \(1, 5\)"):
        scripted_teachers("scripted:JacoPush-v0")[0].act(np.zeros((1, 5)), np.zeros((1, 3)))
    with pytest.raises(ValueError, match="'expert' advises 2 arms, the student has 3"):
        make_advisor("early", make_expert("DualJacoPush-v0"), 100, n_arms=3)
    env = SaverVecEnv("JacoPush-v0", n_envs=1)
    model = GoalTD3("MultiInputPolicy", env)
    advisor = make_advisor("early", "scripted:JacoPush-v0", 100, n_arms=1)
    with pytest.raises(TypeError, match="is code, and has no weights to start from"):
        warm_start_from_teachers(model, advisor.teachers, advisor.mapping)
    env.close()
