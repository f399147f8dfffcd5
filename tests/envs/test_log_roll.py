"""Log roll: starts, what agents see of thorax and pelvis, and what fails an episode."""

from __future__ import annotations

import math
import re
from functools import partial
from typing import Any

import numpy as np
import pytest
import rollouts
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from rollouts import assert_same, begun, pickled_and_back, seen_part, settled_anew, touching

from saver_envs.envs.parallel_env import SaverParallelEnv
from saver_envs.episodes import Episodes
from saver_envs.people.limp_people import LimpPeople
from saver_envs.registration import make_episodes
from saver_envs.simulation import multiply_quaternions
from saver_envs.tasks.care_starts import moved, settled
from saver_envs.tasks.log_roll import GREATEST_WAY, MOST_TURN, LogRoll
from saver_envs.tasks.trunk import Trunk

ENV_ID = "LogRoll-v0"
IDLE = np.zeros(6)

started = partial(rollouts.started, ENV_ID)


def root(episodes: Episodes) -> NDArray[np.float64]:
    """Return the place and quaternion (7,) of the pelvis, a view."""
    addresses = episodes.simulation.keep(LimpPeople).layout.root_qpos
    return np.asarray(episodes.simulation.qpos[0, addresses[0] : addresses[0] + 7])


def rolled(episodes: Episodes, degrees: float, twist: float = 0.0) -> None:
    """Turn the person about the world's y axis, on which the spine lies, and the thorax more."""
    half = math.radians(degrees) / 2
    turn = np.array([math.cos(half), 0.0, math.sin(half), 0.0])
    layout = episodes.simulation.keep(LimpPeople).layout
    quaternion = layout.root_qpos[3:]
    present = episodes.simulation.qpos[0, quaternion]
    episodes.simulation.qpos[0, quaternion] = multiply_quaternions(turn, present)
    episodes.simulation.qpos[0, layout.root_qpos[2]] += 0.5  # clear of bed and tools
    episodes.simulation.qpos[0, layout.joint_qpos["spine_twist"]] -= math.radians(twist)
    episodes.simulation.refresh()
    episodes._read()


def outcome(episodes: Episodes) -> Any:
    return episodes._outcome(np.zeros(1, dtype=bool))


@given(seed=st.integers(0, 2**31))
def test_a_start_keeps_the_rules(seed: int) -> None:
    episodes = started(seed)
    who = int(episodes.memory["who"][0])
    wanted = episodes.goal[0]
    assert wanted[0] == wanted[1]
    assert math.radians(30) <= wanted[0] <= MOST_TURN[who]
    assert np.abs(episodes.observation().achieved_goal).max() < math.radians(1)
    assert not touching(episodes, np.arange(1)).any()
    gap = -seen_part(episodes, "object position relative to the gripper")[0]
    radius = seen_part(episodes, "object radius")[0, :, 0]
    before = -gap[:, 0] - radius
    assert (before > 0.055).all()
    assert (before < 0.145).all()
    assert (np.abs(gap[:, 1]) < 0.06).all()
    height = seen_part(episodes, "gripper position")[0, :, 2] - LogRoll.bed.centre[2]
    assert (height > 0.029).all()
    assert (height < 0.101).all()
    left, right = (
        episodes.scene.model.site(f"joint_{side}_wrist").id for side in ("left", "right")
    )
    places = episodes.simulation.site_position[0]
    assert places[left, 2] > places[right, 2] + 0.05  # one arm across the chest, the other out


def test_a_person_rests() -> None:
    episodes = begun(ENV_ID, 6)
    for _ in range(15):
        result = episodes.step(np.tile(IDLE, (6, 1)))
    assert not result.measured["cost_collision"].any()
    assert result.cost.max() == 0.0
    assert result.measured["way"].max() < 0.005
    assert result.measured["twist"].max() < math.radians(1)
    assert result.measured["head"].max() < math.radians(2)


@pytest.mark.parametrize("index", [0, 31])
def test_a_settled_start_is_what_the_task_settles(index: int) -> None:
    """Of one person, for the others take as long: another world asks for other starts."""
    task, who = LogRoll(2), 3
    pose = settled_anew(task, who, index)
    np.testing.assert_allclose(settled(task.name)[who, index], pose, atol=5e-3)


@given(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(-0.2, 0.2))
def test_moving_a_person_over_the_bed(x: float, y: float, turn: float) -> None:
    centre = LogRoll.bed.centre
    pose = settled("log roll")[1, 0]
    there = moved(pose, centre, np.array([x, y, turn]))
    np.testing.assert_array_equal(there[7:], pose[7:])
    assert there[2] == pose[2]
    assert np.linalg.norm(there[3:7]) == pytest.approx(np.linalg.norm(pose[3:7]))
    shifted = there[:2] - centre[:2] - (x, y)
    assert np.linalg.norm(shifted) == pytest.approx(np.linalg.norm(pose[:2] - centre[:2]))
    back = moved(moved(there, centre, np.array([-x, -y, 0])), centre, np.array([0, 0, -turn]))
    np.testing.assert_allclose(back, pose, atol=1e-12)


@pytest.mark.parametrize("degrees", [-20.0, 10.0, 44.0])
def test_turns_are_those_of_thorax_and_pelvis(degrees: float) -> None:
    episodes = started(1)
    rolled(episodes, degrees)
    turns = np.degrees(episodes.observation().achieved_goal[0])
    np.testing.assert_allclose(turns, degrees, atol=1.0)
    before = started(1).simulation.keep(Trunk).turns()[0]
    np.testing.assert_allclose(before, 0.0, atol=math.radians(1))


@pytest.mark.parametrize(("twist", "cost"), [(8.0, 0.0), (12.0, 1.0), (-12.0, 1.0)])
def test_a_twist_costs(twist: float, cost: float) -> None:
    episodes = started(2)
    rolled(episodes, 35.0, twist)
    measured = outcome(episodes).measured
    assert measured["cost_twist"].item() == cost
    assert np.degrees(measured["twist"].item()) == pytest.approx(abs(twist), abs=1.5)


@pytest.mark.parametrize(("bend", "cost"), [(13.0, 0.0), (17.0, 1.0), (-17.0, 1.0)])
def test_a_bent_head_costs_but_not_one_that_looks_aside(bend: float, cost: float) -> None:
    layout = started(3).simulation.keep(LimpPeople).layout
    for name, expected in (("neck_bend", cost), ("neck_rotation", 0.0)):
        episodes = started(3)
        episodes.simulation.qpos[0, layout.joint_qpos[name]] += math.radians(bend)
        episodes.simulation.refresh()
        measured = outcome(episodes).measured
        assert measured["cost_head"].item() == expected
        if name == "neck_bend":
            assert np.degrees(measured["head"].item()) == pytest.approx(abs(bend), abs=1.0)


@pytest.mark.parametrize(("way", "cost"), [(GREATEST_WAY - 0.01, 0.0), (GREATEST_WAY + 0.01, 1.0)])
def test_a_person_who_is_moved_costs(way: float, cost: float) -> None:
    episodes = started(4)
    layout = episodes.simulation.keep(LimpPeople).layout
    episodes.simulation.qpos[0, layout.root_qpos[0]] += way
    episodes.simulation.refresh()
    measured = outcome(episodes).measured
    assert measured["way"].item() == pytest.approx(way)
    assert measured["cost_way"].item() == cost


def test_the_goal_has_to_be_held() -> None:
    """For 50 actions without a break; one step of a hard cost fails the episode."""
    episodes = started(5)
    episodes.goal[:] = episodes.observation().achieved_goal
    succeeded = [episodes.step(IDLE[None]).success.item() for _ in range(52)]
    assert succeeded == [False] * 49 + [True] * 3
    episodes.goal[:] += 1.0
    assert not episodes.step(IDLE[None]).reached.item()
    episodes.goal[:] -= 1.0
    result = episodes.step(IDLE[None])
    assert result.reached.item()
    assert not result.success.item()


def test_copies_keep_people_and_how_they_lay() -> None:
    episodes = begun(ENV_ID, 2, randomization="wide")
    episodes.step(np.full((2, 6), 0.1))
    copied = pickled_and_back(episodes)
    for _ in range(2):
        assert_same(
            vars(episodes.step(np.full((2, 6), 0.2))), vars(copied.step(np.full((2, 6), 0.2)))
        )


def test_every_agent_sees_its_part_of_the_trunk_and_the_person() -> None:
    env = SaverParallelEnv(ENV_ID)
    first, second = env.reset(seed=3)[0].values()
    assert first.shape == second.shape == (32 + 2 + 1,)
    np.testing.assert_array_equal(first[32:34], second[32:34])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n_arms": 1}, "n_arms=1: must be exactly 2, one each for thorax and pelvis"),
        ({"person_body": 9}, "person_body=9: must be 0 to 7"),
        ({"bed_friction": 3.0}, "bed_friction=3.0: must be 0.02 to 1.5"),
        ({"success_threshold": 0.6}, "success_threshold=0.6: must be between 0 and 0.52 rad"),
    ],
)
def test_bad_options(options: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        make_episodes(ENV_ID, **options)
