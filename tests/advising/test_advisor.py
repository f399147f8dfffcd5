import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from toy_arms import ACTION, GOAL, N_ARMS, OBSERVATION, ToyArms, linear_teacher, make_teacher

from saver_advisors.advising import make_advisor, make_strategy


def observation(n_envs, seed=0):
    rng = np.random.default_rng(seed)
    shapes = {
        "observation": N_ARMS * OBSERVATION,
        "achieved_goal": N_ARMS * GOAL + 1,
        "desired_goal": N_ARMS * GOAL + 1,
    }
    return {key: rng.normal(size=(n_envs, n)).astype(np.float32) for key, n in shapes.items()}


def students(n_envs, seed=1):
    size = (n_envs, N_ARMS * ACTION)
    return np.random.default_rng(seed).uniform(-0.5, 0.5, size).astype(np.float32)


def test_advised_arms_get_the_teachers_action_and_no_others_change():
    teacher, obs, own = make_teacher(), observation(6), students(6)
    advisor = make_advisor("mc-act", teacher, 100, n_arms=2, threshold=1.5)
    actions, mask = advisor.advise(obs, own)
    assert 0 < mask.sum() < mask.size, "the case must have both kinds"
    for env in range(6):
        for arm in range(2):
            block = slice(arm * ACTION, (arm + 1) * ACTION)
            state = obs["observation"][env : env + 1, arm * OBSERVATION : (arm + 1) * OBSERVATION]
            goal = obs["desired_goal"][env : env + 1, arm * GOAL : (arm + 1) * GOAL]
            expected = teacher.act(state, goal)[0] if mask[env, arm] else own[env, block]
            np.testing.assert_allclose(actions[env, block], expected, rtol=1e-5, atol=1e-6)
    np.testing.assert_array_equal(own, students(6), "the student's array is left alone")


def test_each_arm_may_have_its_own_teacher():
    left, right = make_teacher(1, name="left"), make_teacher(2, name="right")
    advisor = make_advisor("early", [left, right], 100, n_arms=2)
    obs = observation(3)
    actions, _ = advisor.advise(obs, students(3))
    for arm, teacher in enumerate((left, right)):
        state = obs["observation"][:, arm * OBSERVATION : (arm + 1) * OBSERVATION]
        goal = obs["desired_goal"][:, arm * GOAL : (arm + 1) * GOAL]
        own = actions[:, arm * ACTION : (arm + 1) * ACTION]
        np.testing.assert_allclose(own, teacher.act(state, goal), rtol=1e-5, atol=1e-6)
    assert advisor.state_dict()["teachers"] == ["left", "right"]


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 30), st.lists(st.integers(1, 7), max_size=8))
def test_the_budget_counts_environment_steps_not_arms(total, vectors):
    advisor = make_advisor("early", make_teacher(), total, n_arms=2)
    advised = 0
    for n_envs in vectors:
        _, mask = advisor.advise(observation(n_envs), students(n_envs))
        advised += int(mask.any(axis=1).sum())
        assert mask.any(axis=1).sum() == mask.all(axis=1).sum()
    assert advised == advisor.spent == min(total, sum(vectors))


def test_a_spent_budget_asks_no_teacher():
    advisor = make_advisor("early", make_teacher(), 0, n_arms=2)
    own = students(2)
    actions, mask = advisor.advise({}, own)
    assert actions is own
    assert not mask.any()


def test_log_values_are_means_over_the_window():
    advisor = make_advisor("mc-q", linear_teacher(), 3, n_arms=2, threshold=0.4, twin_minimum=False)
    own = np.array([[-0.25, 0.25, 0.25, 0.25], [0.25, 0.25, 0.25, 0.25]], np.float32)
    advisor.advise(observation(2), own)
    values = advisor.log_values()
    assert values["advice/spent"] == 1
    assert values["advice/remaining"] == 2
    assert values["advice/share"] == 0.5
    assert (values["advice/share_arm_0"], values["advice/share_arm_1"]) == (0.5, 0.0)
    assert values["advice/disagreement"] == pytest.approx(0.5 / 4, abs=1e-6)
    assert values["advice/q_gap"] == pytest.approx(0.5 / 4, abs=1e-6)
    advisor.start_window()
    assert set(advisor.log_values()) == {"advice/spent", "advice/remaining"}


def test_state_survives_json():
    advisor = make_advisor("early", make_teacher(), 10, n_arms=2)
    advisor.advise(observation(4), students(4))
    state = json.loads(json.dumps(advisor.state_dict()))
    resumed = make_advisor("early", make_teacher(), 10, n_arms=2)
    resumed.load_state_dict(state)
    assert resumed.spent == 4
    assert resumed.advised_per_arm.tolist() == [4, 4]
    assert resumed.state_dict() == advisor.state_dict()
    _, mask = resumed.advise(observation(8), students(8))
    assert mask.any(axis=1).tolist() == [True] * 6 + [False] * 2


def test_a_state_of_another_kind_is_refused():
    state = make_advisor("early", make_teacher(), 10, n_arms=2).state_dict()
    with pytest.raises(ValueError, match="'early', this advisor's is 'mc-act'"):
        make_advisor("mc-act", make_teacher(), 10, n_arms=2).load_state_dict(state)
    with pytest.raises(ValueError, match="2 arms, this advisor has 3"):
        make_advisor("early", make_teacher(), 10, n_arms=3).load_state_dict(state)


def test_mc_q_needs_critics_and_says_what_works():
    with pytest.raises(ValueError, match="no critics: use 'early', 'mc-act' or 'mc-actabs'"):
        make_advisor("mc-q", make_teacher(critics=0), 10, n_arms=2)
    with pytest.raises(ValueError, match="no critics"):
        make_advisor("early-mc", make_teacher(critics=0), 10, n_arms=2)
    make_advisor("early-mc", make_teacher(critics=0), 10, n_arms=2, correcting="mc-act")


def test_a_teacher_of_another_size_is_refused_with_sizes():
    env = ToyArms()
    boxes = {"observation_space": env.observation_space, "action_space": env.action_space}
    assert make_advisor("early", make_teacher(), 10, **boxes).mapping.n_arms == 2
    wide = make_teacher(inputs=(("observation", 5), ("desired_goal", GOAL)))
    with pytest.raises(ValueError, match=r"observation has size 8, but 2 arm\(s\) of 5 need 10"):
        make_advisor("early", wide, 10, **boxes)
    with pytest.raises(ValueError, match=r"actions of size 3, .* size 4"):
        make_advisor("early", make_teacher(action_size=3), 10, **boxes)
    with pytest.raises(ValueError, match=r"observation has size 8, but 3 arm\(s\) of 4 need 12"):
        make_advisor("early", make_teacher(), 10, n_arms=3, **boxes)


def test_arguments_are_checked():
    teacher = make_teacher()
    with pytest.raises(ValueError, match="n_arms, or observation_space"):
        make_advisor("early", teacher, 10)
    for space in ("observation_space", "action_space"):
        with pytest.raises(ValueError, match="n_arms, or observation_space"):
            make_advisor("early", teacher, 10, **{space: getattr(ToyArms(), space)})
    with pytest.raises(ValueError, match="compare='loud'"):
        make_advisor("early", teacher, 10, n_arms=2, compare="loud")
    with pytest.raises(ValueError, match="3 teachers for 2 arms"):
        make_advisor("early", [teacher] * 3, 10, n_arms=2)
    with pytest.raises(ValueError, match="empty"):
        make_advisor("early", [], 10, n_arms=2)
    with pytest.raises(ValueError, match="given by name"):
        make_advisor(make_strategy("early"), teacher, 10, n_arms=2, threshold=0.1)
