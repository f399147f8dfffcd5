import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import given
from hypothesis import strategies as st

from saver_advisors.policies.mapping import ArmMapping

sizes = st.integers(1, 6)


def goal_space(observation: int, goal: int) -> spaces.Dict:
    return spaces.Dict(
        {
            "observation": spaces.Box(-1, 1, (observation,)),
            "achieved_goal": spaces.Box(-1, 1, (goal,)),
            "desired_goal": spaces.Box(-1, 1, (goal,)),
        }
    )


@given(sizes, sizes, sizes, sizes, st.integers(0, 3), st.integers(0, 5))
def test_blocks_lie_in_order_and_join_again(n, observation, goal, action, extra, batch):
    mapping = ArmMapping(n, observation, goal, action)
    flat = np.arange(batch * n * observation, dtype=float).reshape(batch, n * observation)
    blocks = mapping.split_observation(flat)
    for arm in range(n):
        own = flat[:, arm * observation : (arm + 1) * observation]
        np.testing.assert_array_equal(blocks[:, arm], own)
    goals = np.arange(batch * (n * goal + extra), dtype=float).reshape(batch, n * goal + extra)
    for arm in range(n):
        own = goals[:, arm * goal : (arm + 1) * goal]
        np.testing.assert_array_equal(mapping.split_goal(goals)[:, arm], own)
    actions = np.arange(batch * n * action, dtype=float).reshape(batch, n * action)
    np.testing.assert_array_equal(mapping.join_actions(mapping.split_action(actions)), actions)


def test_leading_dimensions_are_free():
    mapping = ArmMapping(2, 28, 3, 4)
    assert mapping.split_observation(np.zeros(56)).shape == (2, 28)
    assert mapping.split_observation(np.zeros((5, 4, 56))).shape == (5, 4, 2, 28)
    assert mapping.split_goal(np.zeros((5, 7))).shape == (5, 2, 3)
    assert mapping.join_actions(np.zeros((5, 4, 2, 4))).shape == (5, 4, 8)


def test_slices_are_views():
    mapping = ArmMapping(2, 28, 3, 4)
    observation, goal = np.zeros((3, 56)), np.zeros((3, 7))
    assert np.shares_memory(mapping.split_observation(observation), observation)
    assert np.shares_memory(mapping.split_goal(goal), goal)


@pytest.mark.parametrize(
    ("arms", "goal", "action", "per_arm"), [(1, 3, 3, 3), (2, 6, 8, 4), (2, 7, 8, 4)]
)
def test_sizes_of_the_environments(arms, goal, action, per_arm):
    mapping = ArmMapping(arms, 28, 3, per_arm)
    mapping.check_spaces(goal_space(28 * arms, goal), spaces.Box(-1, 1, (action,)))


@pytest.mark.parametrize(
    ("observation", "goal", "action", "message"),
    [
        (30, 6, 8, r"observation has size 30, but 2 arm\(s\) of 28 need 56"),
        (56, 5, 8, "achieved_goal has size 5, .*at least 6"),
        (56, 6, 7, r"action has size 7, but 2 arm\(s\) of 4 need 8"),
    ],
)
def test_misfits_are_refused_with_their_sizes(observation, goal, action, message):
    mapping = ArmMapping(2, 28, 3, 4)
    with pytest.raises(ValueError, match=message):
        mapping.check_spaces(goal_space(observation, goal), spaces.Box(-1, 1, (action,)))


def test_what_arms_share_belongs_to_none():
    mapping = ArmMapping(2, 18, 3, 4, shared_observation=16)
    action = spaces.Box(-1, 1, (8,))
    mapping.check_spaces(goal_space(52, 6), action)
    with pytest.raises(ValueError, match=r"observation has size 35, but 2 arm\(s\) of 18 need 36"):
        mapping.check_spaces(goal_space(51, 6), action)
    seen = np.arange(104.0).reshape(2, 52)
    np.testing.assert_array_equal(mapping.split_observation(seen)[1, 1], seen[1, 18:36])


def test_other_kinds_of_spaces_are_refused():
    mapping = ArmMapping(1, 28, 3, 3)
    with pytest.raises(TypeError, match="Dict observation"):
        mapping.check_spaces(spaces.Box(-1, 1, (28,)), spaces.Box(-1, 1, (3,)))
    with pytest.raises(TypeError, match="Box 'action'"):
        mapping.check_spaces(goal_space(28, 3), spaces.Discrete(3))
    without = spaces.Dict({"observation": spaces.Box(-1, 1, (28,))})
    with pytest.raises(TypeError, match="'achieved_goal'"):
        mapping.check_spaces(without, spaces.Box(-1, 1, (3,)))


@pytest.mark.parametrize("wrong", [0, -1, 1.5, True])
def test_sizes_must_be_whole_and_positive(wrong):
    with pytest.raises(ValueError, match="n_arms"):
        ArmMapping(wrong, 28, 3, 4)


def test_arrays_of_another_size_are_refused():
    mapping = ArmMapping(2, 28, 3, 4)
    with pytest.raises(ValueError, match=r"\(1, 28\).*56"):
        mapping.split_observation(np.zeros((1, 28)))
    with pytest.raises(ValueError, match=r"2 arm\(s\) x 3 = 6"):
        mapping.split_goal(np.zeros((1, 5)))
    with pytest.raises(ValueError, match=r"\(2, 4\)"):
        mapping.join_actions(np.zeros((1, 2, 3)))
