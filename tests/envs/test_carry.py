"""Carry: where board, block and targets are, what agents see of them, and what fails an episode."""

from __future__ import annotations

import re
from functools import partial

import mujoco
import numpy as np
import pytest
import rollouts
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from rollouts import begun, random_actions, seen_part, touching

from saver_envs.envs.parallel_env import SaverParallelEnv
from saver_envs.episodes import Episodes
from saver_envs.registration import make_episodes
from saver_envs.scenes import FreeBodies, free_bodies

ENV_ID = "DualJacoCarry-v0"
IDLE = np.tile([0.0, 0.0, 0.0, 1.0], 2)
#: From the tool into the palm (m).
UP = np.array([0.0, 0.0, 0.07])
BASES = np.array([[0.0, -0.36, 0.0], [0.0, 0.36, 0.0]])

started = partial(rollouts.started, ENV_ID)


def bodies(episodes: Episodes) -> FreeBodies:
    return free_bodies(episodes.scene, ("board", "load"))


def quaternion(axis: tuple[float, float, float], degrees: float) -> NDArray[np.float64]:
    half = np.radians(degrees) / 2
    return np.array([np.cos(half), *(np.sin(half) * np.array(axis))])


def lay(episodes: Episodes, turn: NDArray[np.float64], load: tuple[float, float, float]) -> None:
    """Put the board at (0.42, 0, 0.3) with this quaternion, and the block there in its frame."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, turn)
    board = np.array([0.42, 0.0, 0.3])
    own = bodies(episodes)
    episodes.simulation.qpos[0, own.qpos[0]] = [*board, *turn]
    place = board + matrix.reshape(3, 3) @ load
    episodes.simulation.qpos[0, own.qpos[1]] = [*place, *turn]
    episodes.simulation.qvel[0, own.dof] = 0.0
    episodes.simulation.refresh()
    episodes._read()


@given(seed=st.integers(0, 2**31))
def test_a_start_keeps_the_rules(seed: int) -> None:
    episodes = started(seed)
    board, load = episodes.simulation.qpos[0, bodies(episodes).qpos]
    ends = seen_part(episodes, "object position")[0]
    goals = episodes.goal.reshape(2, 3)
    # The board lies flat on the table, and the block on the board.
    assert board[2] == pytest.approx(0.01)
    np.testing.assert_array_equal(board[4:6], 0.0)
    assert load[2] == pytest.approx(0.04)
    assert (
        np.abs(seen_part(episodes, "load position on the object")[0]) <= [0.031, 0.101, 0.031]
    ).all()
    # Ends and targets: a rigid board's, level, where each arm reaches its own.
    for points in (ends, goals):
        world = points + BASES
        assert np.linalg.norm(world[1] - world[0]) == pytest.approx(0.56, abs=1e-6)
        assert world[1, 2] == pytest.approx(world[0, 2], abs=1e-6)
        assert (points[:, 0] >= 0.30 - 1e-6).all()
        assert (points[:, 0] <= 0.55 + 1e-6).all()
        assert (np.hypot(points[:, 0], points[:, 1]) <= 0.62 + 1e-6).all()
    rise = goals[:, 2] - ends[:, 2]
    assert (rise >= 0.08 - 1e-6).all()
    assert (rise <= 0.25 + 1e-6).all()
    way = np.linalg.norm(goals - ends, axis=-1)
    assert (way >= 0.10 - 1e-6).all()
    assert (way <= 0.30 + 1e-6).all()
    hand = episodes.simulation.arm_state().tool_position[0]
    assert (hand[:, 2] > 0.095 + 0.03 - 2e-3).all()
    to_end = np.linalg.norm(hand - ends, axis=-1)
    assert (to_end >= 0.10 - 2e-3).all()
    assert (to_end <= 0.20 + 2e-3).all()
    assert not touching(episodes, np.arange(1)).any()


def test_board_and_block_rest() -> None:
    episodes = begun(ENV_ID, 6)
    before = episodes.simulation.qpos[:, bodies(episodes).qpos].copy()
    for _ in range(25):
        outcome = episodes.step(np.tile(IDLE, (6, 1)))
        assert not outcome.measured["cost_collision"].any()
    moved = np.abs(episodes.simulation.qpos[:, bodies(episodes).qpos] - before).max()
    assert moved < 1e-3
    assert outcome.measured["tilt"].max() < 1e-3


def test_what_rests_may_touch_what_it_rests_on_alone() -> None:
    episodes = begun(ENV_ID, 3)
    own = bodies(episodes)
    tool = episodes.scene.to_world(episodes.simulation.arm_state().tool_position)[0, 0]
    episodes.simulation.qpos[0, own.qpos[1, :3]] = tool + UP  # in a hand
    episodes.simulation.qpos[1, own.qpos[1, :3]] = [0.7, 0.0, 0.015]  # in the table
    assert touching(episodes, np.arange(3)).tolist() == [True, True, False]


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.6, -0.8, 0.0)])
@pytest.mark.parametrize(("degrees", "cost"), [(9.8, 0.0), (10.2, 1.0), (-10.2, 1.0), (179.0, 1.0)])
def test_a_tilt_beyond_ten_degrees_costs(
    axis: tuple[float, float, float], degrees: float, cost: float
) -> None:
    episodes = started(0)
    lay(episodes, quaternion(axis, degrees), (0.0, 0.0, 0.03))
    measured = episodes._outcome(np.zeros(1, dtype=bool)).measured
    assert measured["cost_tilt"].item() == cost
    assert np.degrees(measured["tilt"].item()) == pytest.approx(abs(degrees), abs=1e-6)


def test_a_turn_about_the_vertical_is_no_tilt() -> None:
    episodes = started(0)
    lay(episodes, quaternion((0.0, 0.0, 1.0), 120.0), (0.0, 0.0, 0.03))
    assert episodes._outcome(np.zeros(1, dtype=bool)).measured["tilt"].item() < 1e-6


@pytest.mark.parametrize(
    ("load", "cost"),
    [
        ((0.0, 0.0, 0.03), 0.0),
        ((0.079, -0.29, 0.03), 0.0),
        ((0.081, 0.0, 0.03), 1.0),
        ((0.0, 0.31, 0.03), 1.0),
        ((0.0, 0.0, -0.03), 1.0),
    ],
)
def test_a_block_that_is_not_above_the_board_has_fallen(
    load: tuple[float, float, float], cost: float
) -> None:
    """In the frame of the board, however that is turned."""
    episodes = started(0)
    lay(episodes, quaternion((0.6, 0.0, 0.8), 70.0), load)
    assert episodes._outcome(np.zeros(1, dtype=bool)).measured["cost_dropped"].item() == cost


@pytest.mark.parametrize("cause", ["tilt", "dropped", None])
def test_one_step_of_a_hard_cost_fails_the_episode(cause: str | None) -> None:
    episodes = started(0)
    level = quaternion((0.0, 0.0, 1.0), 0.0)
    if cause == "tilt":
        lay(episodes, quaternion((1.0, 0.0, 0.0), 15.0), (0.0, 0.0, 0.03))
    elif cause == "dropped":
        lay(episodes, level, (0.3, 0.0, 0.0))
    else:
        lay(episodes, level, (0.0, 0.0, 0.03))
    outcome = episodes._outcome(np.zeros(1, dtype=bool))
    assert outcome.cost.item() == (cause is not None)
    lay(episodes, level, (0.0, 0.0, 0.03))
    episodes.goal[:] = episodes.observation().achieved_goal
    outcome = episodes._outcome(np.zeros(1, dtype=bool))
    assert outcome.reached.item()
    assert outcome.cost.item() == 0
    assert outcome.success.item() == (cause is None)
    assert not started(0)._failed.any()


def test_what_agents_see_of_a_board_that_turns() -> None:
    """A block that turns with the board is at rest on it; the board's middle and ends are rigid."""
    episodes = started(0)
    turn = quaternion((0.0, 0.0, 1.0), 90.0)
    lay(episodes, turn, (0.02, -0.05, 0.03))
    spin, own = np.array([0.0, 0.0, 2.0]), bodies(episodes)
    lever = np.array([0.05, 0.02, 0.03])  # of the block, in the world's frame
    along = np.array([0.1, 0.0, 0.0])
    episodes.simulation.qvel[0, own.dof[0]] = [*along, *spin]
    episodes.simulation.qvel[0, own.dof[1]] = [*(np.cross(spin, lever) + along), *spin]
    episodes.simulation.refresh()
    episodes._read()
    np.testing.assert_allclose(
        seen_part(episodes, "load position on the object")[0], [0.02, -0.05, 0.03], atol=1e-6
    )
    np.testing.assert_allclose(
        seen_part(episodes, "load velocity on the object")[0], 0.0, atol=1e-6
    )
    np.testing.assert_allclose(seen_part(episodes, "object angular velocity")[0], spin, atol=1e-6)
    np.testing.assert_allclose(
        seen_part(episodes, "object linear velocity")[0], [0.1, 0, 0], atol=1e-6
    )
    orientation = seen_part(episodes, "object orientation, a quaternion with w >= 0")
    np.testing.assert_allclose(orientation[0], turn, atol=1e-6)
    # Turned by a right angle, the right end of the board is ahead and the left one behind.
    world = seen_part(episodes, "object position")[0] + BASES
    np.testing.assert_allclose(world, [[0.70, 0, 0.355], [0.14, 0, 0.355]], atol=1e-6)
    tools = episodes.simulation.arm_state().tool_position[0]
    relative = seen_part(episodes, "object position relative to the gripper")[0]
    np.testing.assert_allclose(relative, world - BASES - tools, atol=1e-6)


def test_every_agent_sees_the_board_and_its_own_end() -> None:
    env = SaverParallelEnv(ENV_ID)
    first, second = env.reset(seed=3)[0].values()
    assert first.shape == second.shape == (34 + 3,)
    # What is shared follows the hand and the end; then comes the target.
    np.testing.assert_array_equal(first[18:34], second[18:34])
    ends = np.concatenate([first[12:15], second[12:15]])
    np.testing.assert_array_equal(ends, env.episodes.observation().achieved_goal[0])


def test_hands_may_touch_the_board_but_not_the_block() -> None:
    for name, cost in (("board", 0.0), ("load", 1.0)):
        episodes = started(1)
        own, moved = bodies(episodes), ("board", "load").index(name)
        tool = episodes.scene.to_world(episodes.simulation.arm_state().tool_position)[0, 0]
        palm = tool + UP
        episodes.simulation.qpos[0, own.qpos[moved, :3]] = palm
        if name == "board":  # and the block elsewhere
            episodes.simulation.qpos[0, own.qpos[1, :3]] = [0.7, 0.0, 0.02]
        assert episodes.step(IDLE[None]).measured["cost_collision"].item() == cost


def test_a_load_beyond_the_tables_edge_is_lost() -> None:
    episodes = started(2)
    edge = episodes.scene.table.upper[0]
    episodes.simulation.qpos[0, bodies(episodes).qpos[1, 0]] = edge + 0.01
    assert episodes.step(IDLE[None]).lost.item()


def test_a_table_of_another_height_has_board_block_and_targets_on_it() -> None:
    for options in ({"table_height": 0.03}, {"randomization": {"table_height": 0.03}}):
        episodes = begun(ENV_ID, 4, **options)
        poses = episodes.simulation.qpos[:, bodies(episodes).qpos]
        np.testing.assert_allclose(poses[:, 0, 2], 0.04)
        np.testing.assert_allclose(poses[:, 1, 2], 0.07)
        heights = episodes.goal.reshape(4, 2, 3)[..., 2]
        assert (heights >= 0.03 + 0.065 + 0.08 - 1e-6).all()
        for action in random_actions(8, 25, 4):
            outcome = episodes.step(0.0 * action + IDLE)
        assert outcome.measured["tilt"].max() < 1e-3
        np.testing.assert_allclose(seen_part(episodes, "object position")[..., 2], 0.095, atol=1e-3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n_arms": 1}, "n_arms=1: must be exactly 2, one for each end"),
        ({"n_arms": 3}, "n_arms=3: must be exactly 2"),
        ({"board_mass": 0.0}, "board_mass=0.0: must be 0.05 to 2 kg"),
        ({"load_mass": 5.0}, "load_mass=5.0: must be 0.001 to 2 kg"),
        ({"table_height": 0.2}, "table_height=0.2: must be -0.02 to 0.05 m"),
        ({"success_threshold": 0.2}, "success_threshold=0.2: must be between 0 and 0.10 m"),
    ],
)
def test_bad_options(options: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        make_episodes(ENV_ID, **options)
