"""Algorithm 1's replay: goal and constraint in hindsight, and no reward of an old stage."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import given, settings
from hypothesis import strategies as st

from saver_advisors.learner.replay import GoalTransitions
from saver_advisors.variable_reward import ConstraintReplayBuffer, TrainingStage
from saver_advisors.variable_reward.control import reward_of
from saver_envs.tasks.distance import DISTANCE_TOLERANCE, REQUIRED_DISTANCE, Distance

HORIZON, N_ENVS, GOAL = 6, 3, 7
STAGES = {
    stage.name: stage for stage in map(TrainingStage, ("teaching", "stretching", "exploring"))
}


def filled(seed: int = 0, episodes: int = 8, **named: Any) -> ConstraintReplayBuffer:
    """A buffer of random episodes near the goal and near the band."""
    random = np.random.default_rng(seed)
    goal_space = spaces.Box(-np.inf, np.inf, (GOAL,), np.float32)
    space = spaces.Dict(
        observation=spaces.Box(-np.inf, np.inf, (2,), np.float32),
        achieved_goal=goal_space,
        desired_goal=goal_space,
    )
    buffer = ConstraintReplayBuffer(
        HORIZON * N_ENVS * episodes,
        space,
        spaces.Box(-1, 1, (2,), np.float32),
        device="cpu",
        n_envs=N_ENVS,
        horizon=HORIZON,
        seed=seed,
        **named,
    )

    def seen(desired: np.ndarray) -> dict[str, np.ndarray]:
        points = 0.04 * random.standard_normal((N_ENVS, 6))
        band = REQUIRED_DISTANCE + 1.5 * DISTANCE_TOLERANCE * random.standard_normal((N_ENVS, 1))
        return {
            "observation": random.standard_normal((N_ENVS, 2)).astype(np.float32),
            "achieved_goal": np.concatenate((points, band), axis=1).astype(np.float32),
            "desired_goal": desired,
        }

    for _ in range(episodes):
        desired = np.full((N_ENVS, GOAL), REQUIRED_DISTANCE, np.float32)
        desired[:, :6] = 0.04 * random.standard_normal((N_ENVS, 6))
        before = seen(desired)
        for step in range(HORIZON):
            after = seen(desired)
            action = random.uniform(-1, 1, (N_ENVS, 2))
            done = np.full(N_ENVS, step == HORIZON - 1)
            buffer.add(before, after, action, np.zeros(N_ENVS), done, [{}] * N_ENVS)
            before = after
    return buffer


def distances(drawn: GoalTransitions) -> np.ndarray:
    """(batch, 2) of each object to its target."""
    gap = (drawn.next_achieved_goal - drawn.desired_goal)[:, :6]
    return np.linalg.norm(gap.reshape(-1, 2, 3), axis=-1)


def astray(drawn: GoalTransitions) -> np.ndarray:
    """(batch,) of the objects' distance from what is required."""
    return np.abs(drawn.next_achieved_goal[:, 6] - drawn.desired_goal[:, 6])


def goal_part(drawn: GoalTransitions) -> np.ndarray:
    return np.where((distances(drawn) <= 0.05).all(axis=-1), 0.0, -1.0)


def constraint_part(drawn: GoalTransitions) -> np.ndarray:
    return np.where(astray(drawn) <= DISTANCE_TOLERANCE, 0.0, -1.0)


def test_next_is_algorithm_1() -> None:
    buffer = filled(constraint_relabelling="next", relabel_probability=0.8)
    buffer.reward_function = Distance(2).reward
    drawn = buffer.sample_transitions(2000)
    relabelled = drawn.goal_step[:, 0] >= 0
    assert 0.7 < relabelled.mean() < 0.9
    np.testing.assert_array_equal(
        drawn.desired_goal[relabelled, 6], drawn.next_achieved_goal[relabelled, 6]
    )
    assert (drawn.desired_goal[~relabelled, 6] == np.float32(REQUIRED_DISTANCE)).all()
    source = buffer.achieved_goal[drawn.slot, drawn.goal_step[:, 0]]
    np.testing.assert_array_equal(drawn.desired_goal[relabelled, :6], source[relabelled, :6])
    assert (constraint_part(drawn)[relabelled] == 0).all(), "the text's consequence: always kept"


@pytest.mark.parametrize("parts", [None, (3, 3, 1)])
def test_keep_leaves_the_required_value(parts: tuple[int, ...] | None) -> None:
    buffer = filled(constraint_relabelling="keep", goal_parts=parts, relabel_probability=1.0)
    buffer.reward_function = Distance(2).reward
    drawn = buffer.sample_transitions(500)
    assert (drawn.desired_goal[:, 6] == np.float32(REQUIRED_DISTANCE)).all()
    assert -1 in constraint_part(drawn), "so leaving the band is seen"
    if parts is not None:
        assert (drawn.goal_step[:, 2] == -1).all()
        np.testing.assert_array_equal(drawn.reward[:, 2], constraint_part(drawn))


def test_future_takes_the_whole_state() -> None:
    buffer = filled(constraint_relabelling="future", relabel_probability=1.0)
    buffer.reward_function = Distance(2).reward
    drawn = buffer.sample_transitions(500)
    source = buffer.achieved_goal[drawn.slot, drawn.goal_step[:, 0]]
    np.testing.assert_array_equal(drawn.desired_goal, source)


@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 1000),
    st.sampled_from(["next", "future", "keep"]),
    st.sampled_from(["min", "linear"]),
    st.lists(st.sampled_from(sorted(STAGES)), min_size=2, max_size=6),
)
def test_no_reward_of_an_old_stage_survives(
    seed: int, relabelling: Any, combination: Any, order: list[str]
) -> None:
    """Whatever the order of stages, every sampled reward is that of the stage in force."""
    buffer = filled(seed, episodes=2, constraint_relabelling=relabelling)
    task = Distance(2, reward_combination=combination)
    for name in order:
        stage = STAGES[name]
        buffer.reward_function = reward_of(stage, task)
        drawn = buffer.sample_transitions(64)
        goal, constraint = goal_part(drawn), constraint_part(drawn)
        combined = goal + constraint if combination == "linear" else np.minimum(goal, constraint)
        wanted = combined if stage.constrained else goal
        # On the very edge of a threshold either is right.
        clear = (np.abs(distances(drawn) - 0.05) > 1e-6).all(axis=-1)
        clear &= np.abs(astray(drawn) - DISTANCE_TOLERANCE) > 1e-6
        np.testing.assert_array_equal(drawn.reward[clear, 0], wanted[clear])


def test_bad_arguments() -> None:
    with pytest.raises(ValueError, match="constraint_relabelling='past'"):
        filled(constraint_relabelling="past")
