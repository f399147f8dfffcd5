"""Rewards, success and costs as functions of goals."""

from __future__ import annotations

import copy

import gymnasium
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from rollouts import (
    ALL_IDS,
    FEW_IDS,
    begun,
    cubes_of,
    objects_of,
    pickled_and_back,
    random_actions,
    targets_of,
)

from saver_envs.people.contact_forces import FORCE_COSTS, TORQUE_COSTS
from saver_envs.registration import ENVIRONMENTS, make_episodes
from saver_envs.tasks.contract import Task
from saver_envs.tasks.distance import Distance

COORDINATES = st.floats(-1, 1, width=32)


def tasks() -> list[Task]:
    return [make_episodes(env_id).task for env_id in ALL_IDS if "Mico" not in env_id]


TASKS = tasks()


@given(data=st.data())
@pytest.mark.parametrize("task", TASKS, ids=lambda task: f"{task.name}-{task.reward_type}")
def test_reward_is_pure_and_vectorised(task: Task, data: st.DataObject) -> None:
    leading = data.draw(hnp.array_shapes(min_dims=1, max_dims=3, max_side=3), "leading")
    shape = (*leading, task.goal_layout.size)
    achieved = data.draw(hnp.arrays(np.float32, shape, elements=COORDINATES), "achieved")
    near = data.draw(hnp.arrays(np.float32, shape, elements=st.floats(-0.0625, 0.0625, width=32)))
    desired = achieved + near
    given_away = achieved.copy(), desired.copy()
    reward = task.reward(achieved, desired)
    assert reward.shape == leading
    assert reward.dtype == np.float32
    np.testing.assert_array_equal(achieved, given_away[0])
    np.testing.assert_array_equal(desired, given_away[1])
    np.testing.assert_array_equal(reward, task.reward(achieved, desired))
    for index in np.ndindex(*leading):
        assert task.reward(achieved[index], desired[index]) == reward[index]
    np.testing.assert_array_equal(task.reward(desired, desired), 0)


@given(
    achieved=hnp.arrays(np.float64, (5, 7), elements=COORDINATES),
    desired=hnp.arrays(np.float64, (5, 7), elements=COORDINATES),
)
def test_rewards_are_the_formulas(achieved: np.ndarray, desired: np.ndarray) -> None:
    """Equations 6.3 and 6.4, object by object."""
    achieved[:, -1], desired[:, -1] = np.abs(achieved[:, -1]), 0.35
    first = np.linalg.norm(achieved[:, :3] - desired[:, :3], axis=-1)
    second = np.linalg.norm(achieved[:, 3:6] - desired[:, 3:6], axis=-1)
    f_g = np.where((first <= 0.05) & (second <= 0.05), 0, -1)
    f_c = np.where(np.abs(achieved[:, -1] - 0.35) <= 0.015, 0, -1)
    rewards = {stage: Distance(2, reward_stage=stage) for stage in ("goal", "constrained")}
    np.testing.assert_array_equal(rewards["goal"].reward(achieved, desired), f_g)
    np.testing.assert_array_equal(
        rewards["constrained"].reward(achieved, desired), np.minimum(f_c, f_g)
    )
    linear = Distance(2, reward_combination="linear", constraint_weight=0.5)
    np.testing.assert_array_equal(linear.reward(achieved, desired), f_g + 0.5 * f_c)
    assert linear.reward(achieved, desired).min() >= linear.least_reward == -1.5
    shaped = Distance(2, reward_combination="shaped", constraint_weight=0.5)
    share = np.minimum(np.abs(achieved[:, -1] - 0.35) / 0.06, 1)
    np.testing.assert_allclose(
        shaped.reward(achieved, desired), f_g + 0.25 * (f_c - share), atol=1e-6
    )
    assert shaped.reward(achieved, desired).min() >= shaped.least_reward == -1.5
    assert rewards["constrained"].least_reward == -1.0
    assert Distance(2, reward_stage="goal", reward_combination="linear").least_reward == -1.0


def test_success_is_per_object_and_not_of_the_whole_vector() -> None:
    task = make_episodes("DualJacoPush-v0").task
    desired = np.zeros(6)
    both_near = np.array([0.045, 0, 0, 0, 0.045, 0])  # 0.064 m as one vector of six
    assert task.reward(both_near, desired) == 0
    one_far = np.array([0.051, 0, 0, 0, 0, 0])
    assert task.reward(one_far, desired) == -1


def test_a_goal_is_reached_at_the_threshold_itself() -> None:
    task = make_episodes("JacoPush-v0", success_threshold=0.0625).task
    at, beyond = np.array([0.0625, 0, 0]), np.array([np.nextafter(0.0625, 1), 0, 0])
    assert (task.reward(at, np.zeros(3)), task.reward(beyond, np.zeros(3))) == (0, -1)


def test_dense_rewards_are_minus_the_distances() -> None:
    achieved = np.array([0.3, 0.4, 0, 0, 0, 0.25])
    assert make_episodes("DualJacoPushDense-v0").task.reward(achieved, np.zeros(6)) == -0.75
    distance = make_episodes("DualJacoDistanceDense-v0", reward_stage="constrained").task
    goal = np.append(np.zeros(6), 0.35)
    reward = distance.reward(np.append(achieved, 0.45), goal)
    assert reward == pytest.approx(-0.75 - 0.1)


@pytest.mark.parametrize("env_id", ALL_IDS)
def test_steps_give_the_reward_of_their_goals(env_id: str) -> None:
    """Bit for bit from what was handed out, so that a relabelling buffer finds the same."""
    env = gymnasium.make(env_id).unwrapped
    env.reset(seed=0)
    for action in random_actions(env.action_space.shape[0], 8, 1)[:, 0]:
        seen, reward, terminated, _, info = env.step(action)
        goals = seen["achieved_goal"], seen["desired_goal"]
        assert reward == float(env.compute_reward(*goals, info))
        assert reward == float(env.compute_reward(*goals, {}))
        assert terminated == env.compute_terminated(*goals, info)
        assert not env.compute_truncated(*goals, info)
    stacked = np.stack([goals[0]] * 4)
    assert env.compute_reward(stacked, np.stack([goals[1]] * 4), [{}] * 4).shape == (4,)
    assert env.compute_terminated(stacked, stacked, [{}] * 4).shape == (4,)


@pytest.mark.parametrize("env_id", FEW_IDS)
def test_an_object_at_its_target_is_a_success(env_id: str) -> None:
    episodes = begun(env_id, 2, control="joints")  # joints hold still
    simulation = episodes.simulation
    targets_of(episodes)[..., 2] = episodes.task.object_size / 2
    simulation.qpos[0, cubes_of(episodes).qpos[:, :3]] = episodes.targets()[0]
    outcome = episodes.step(np.zeros((2, episodes.action_size)))
    assert outcome.reached.tolist() == [True, False]
    if "Distance" not in env_id:
        assert outcome.success.tolist() == [True, False]
        assert outcome.reward.tolist() == [0, -1]


def test_the_distance_task_remembers_that_the_band_was_left() -> None:
    episodes = begun("DualJacoDistance-v0", 2, control="joints")
    simulation = episodes.simulation
    idle = np.zeros((2, episodes.action_size))
    home = simulation.qpos[:, cubes_of(episodes).qpos].copy()
    simulation.qpos[0, cubes_of(episodes).qpos[0, 1]] -= 0.05
    costs = episodes.step(idle).measured["cost_distance"]
    assert costs.tolist() == [1, 0]
    simulation.qpos[:, cubes_of(episodes).qpos] = home
    episodes.goal[:] = episodes.observation().achieved_goal
    episodes.goal[0, :6] = episodes.goal[1, :6] = 0
    episodes.goal[:, :6] = objects_of(episodes).position.reshape(2, 6)
    episodes.goal[:, 6] = 0.35
    outcome = episodes.step(idle)
    assert outcome.measured["cost_distance"].tolist() == [0, 0]
    assert outcome.reached.tolist() == [True, True]
    assert outcome.success.tolist() == [False, True]
    episodes.reset([0])
    assert not episodes._failed.any()


def test_a_success_is_safe_until_an_arm_touches_something() -> None:
    episodes = begun("DualJacoPush-v0", 2, control="joints")
    idle = np.zeros((2, episodes.action_size))
    home = episodes.simulation.qpos[:, cubes_of(episodes).qpos].copy()
    tool = episodes.scene.to_world(episodes.simulation.arm_state().tool_position)[0, 0]
    episodes.simulation.qpos[0, cubes_of(episodes).qpos[1, :3]] = tool
    assert episodes.step(idle).measured["cost_collision"].tolist() == [1, 0]
    episodes.simulation.qpos[:, cubes_of(episodes).qpos] = home
    episodes.simulation.qvel[:] = 0
    episodes.goal[:] = objects_of(episodes).position.reshape(2, 6)
    outcome = episodes.step(idle)
    assert outcome.success.tolist() == [True, True]
    assert outcome.safe_success.tolist() == [False, True]
    assert outcome.info_of(0)["safe_success"] is False
    episodes.reset([0])
    assert not episodes._collided.any()


def test_an_object_that_was_beyond_the_edge_is_lost_although_it_comes_back() -> None:
    episodes = begun("DualJacoPush-v0", 3, control="joints")
    idle = np.zeros((3, episodes.action_size))
    home = episodes.simulation.qpos[:, cubes_of(episodes).qpos].copy()
    side = episodes.scene.table.upper[1]
    episodes.simulation.qpos[0, cubes_of(episodes).qpos[1, 1]] = side + 0.001
    episodes.simulation.qpos[1, cubes_of(episodes).qpos[1, 1]] = side - 0.001
    assert episodes.step(idle).lost.tolist() == [True, False, False]
    episodes.simulation.qpos[:, cubes_of(episodes).qpos] = home
    episodes.simulation.qvel[:] = 0
    episodes.goal[:] = objects_of(episodes).position.reshape(3, 6)
    for copied in (episodes, copy.deepcopy(episodes), pickled_and_back(episodes)):
        outcome = copied.step(idle)
        assert outcome.lost.tolist() == [True, False, False]
        assert outcome.reached.all(), "the goal alone decides about reward and reached"
        assert (outcome.reward == 0).all()
        assert outcome.success.tolist() == [False, True, True]
        assert outcome.info_of(0)["object_lost"] is True
    assert not episodes.reset([0]).lost.any()


def test_the_edge_is_that_of_the_table_that_is_drawn() -> None:
    for layout in ("row", "ring"):
        episodes = begun("DualJacoPush-v0", layout=layout)
        model = episodes.scene.drawing_model()
        drawn = [k for k in range(model.ngeom) if model.geom_matid[k] == model.material("table").id]
        centre, half = model.geom_pos[drawn[0], :2], model.geom_size[drawn[0], :2]
        np.testing.assert_allclose(episodes.scene.table.lower, centre - half)
        np.testing.assert_allclose(episodes.scene.table.upper, centre + half)


def test_costs_that_an_id_names() -> None:
    named = {env_id: row.task.summed for env_id, row in ENVIRONMENTS.items()}
    for env_id, names in named.items():
        expected = ("distance",) if "Distance" in env_id else ("collision",)
        if "Wrist" in env_id:
            expected = ("torso_force", "torso_displacement")
        if "Carry" in env_id:
            expected = ("tilt", "dropped")
        if "LogRoll" in env_id:
            expected = (*FORCE_COSTS, "twist", "head", "way")
        if "Intake" in env_id:
            expected = FORCE_COSTS
        if "Straighten" in env_id:
            expected = (*FORCE_COSTS, *TORQUE_COSTS)
        assert names == expected


def test_contact_costs() -> None:
    """A hand on the table, on a stranger's object, and on the other arm; not on its own object."""
    episodes = begun("DualJacoPush-v0", 1, collision_force=True)
    down = np.zeros((1, 6))
    assert episodes.step(down).measured["cost_collision"] == 0
    simulation = episodes.simulation
    own, strangers = cubes_of(episodes).qpos[0, :3], cubes_of(episodes).qpos[1, :3]
    tool = episodes.scene.to_world(simulation.arm_state().tool_position)[0, 0]
    kept = episodes.get_state()
    for cube, cost in ((own, 0), (strangers, 1)):
        episodes.set_state(kept)
        simulation.qpos[0, cube] = tool
        measured = episodes.step(down).measured
        assert measured["cost_collision"] == cost
        assert (measured["collision_force"] > 0) == (cost == 1)
