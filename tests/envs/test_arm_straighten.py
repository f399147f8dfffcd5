"""Arm straighten: starts, what agents see of the person's arms, and when an arm is straight."""

from __future__ import annotations

import math
import re
from functools import partial
from typing import Any

import mujoco
import numpy as np
import pytest
import rollouts
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from rollouts import assert_same, begun, pickled_and_back, seen_part, settled_anew, touching

from saver_envs.envs.parallel_env import SaverParallelEnv
from saver_envs.episodes import Episodes
from saver_envs.people.contact_forces import FORCE_COSTS, TORQUE_COSTS
from saver_envs.people.limp_people import LimpPeople
from saver_envs.registration import make_episodes
from saver_envs.tasks.arm_straighten import HAND_LOWER, HAND_UPPER, STRAIGHT, ArmStraighten
from saver_envs.tasks.arm_straighten_starts import ASIDE, KINDS, PAIRS, kinds_of, stays
from saver_envs.tasks.care_starts import alone, settled

ENV_ID = "ArmStraighten-v0"
IDLE = np.zeros(8)
BASES = np.array([[0.0, -0.5, 0.0], [0.0, 0.5, 0.0]])

started = partial(rollouts.started, ENV_ID)


def seen(episodes: Episodes, name: str) -> NDArray[np.float64]:
    """Return a part of the observation (arms, size), in its unit."""
    return seen_part(episodes, name)[0]


def outcome(episodes: Episodes) -> Any:
    return episodes._outcome(np.zeros(1, dtype=bool))


@given(seed=st.integers(0, 2**31))
def test_a_start_keeps_the_rules(seed: int) -> None:
    episodes = started(seed)
    assert not touching(episodes, np.arange(1)).any()
    hands = seen(episodes, "gripper position")
    assert (hands > HAND_LOWER - 2e-3).all()
    assert (hands < HAND_UPPER + 2e-3).all()
    # Targets: on the bed, beside the hips, level with one another.
    targets = episodes.targets()[0]
    apart = targets[1] - targets[0]
    assert np.linalg.norm(apart[:2]) == pytest.approx(2 * ASIDE, abs=0.02)
    bed = ArmStraighten.bed
    assert (targets[:, 2] > bed.centre[2] + 0.02).all()
    assert (targets[:, 2] < bed.centre[2] + 0.04).all()
    sites = episodes.scene.model.site
    hips = [sites(f"joint_{side}_hip").id for side in ("right", "left")]
    places = episodes.simulation.site_position[0, hips]
    below = (targets - places)[:, 0]
    assert (below > 0.03).all()
    assert (below < 0.12).all()
    # A nearly straight arm reaches there.
    wrist, elbow, shoulder = (
        seen(episodes, f"{name} position") for name in ("object", "elbow", "shoulder")
    )
    arm = np.linalg.norm(elbow - shoulder, axis=-1) + np.linalg.norm(wrist - elbow, axis=-1)
    reach = np.linalg.norm(targets - BASES - shoulder, axis=-1)
    np.testing.assert_allclose(reach / arm, math.cos(math.radians(7.5)), atol=5e-3)


def test_every_pair_of_kinds_has_its_postures() -> None:
    pairs = [kinds_of(index) for index in range(ArmStraighten.postures)]
    assert len(set(pairs)) == PAIRS
    assert pairs[:PAIRS] == pairs[PAIRS:]


@pytest.mark.parametrize("who", [0, 3, 7])
def test_settled_arms_lie_as_their_kind_says(who: int) -> None:
    bed, world = ArmStraighten.bed, alone(who, ArmStraighten.bed)
    poses = settled("arm straighten")[who]
    for index, pose in enumerate(poses):
        world.data.qpos[world.layout.qpos] = pose
        mujoco.mj_kinematics(world.model, world.data)
        for side, kind in zip(("left", "right"), kinds_of(index), strict=True):
            assert stays(world, bed, side, kind), (index, side, kind)
    assert {kind for index in range(PAIRS) for kind in kinds_of(index)} == set(KINDS)


def test_a_settled_start_is_what_the_task_settles() -> None:
    """Of one person, for the others take as long: another world asks for other starts."""
    task, who, index = ArmStraighten(2), 3, 10
    pose = settled_anew(task, who, index)
    np.testing.assert_allclose(settled(task.name)[who, index], pose, atol=5e-3)


def test_a_person_rests() -> None:
    episodes = begun(ENV_ID, 6)
    before = episodes.observation().achieved_goal
    for _ in range(15):
        result = episodes.step(np.tile(IDLE, (6, 1)))
    assert not result.measured["cost_collision"].any()
    assert result.cost.max() == 0.0
    # Joints are up to a quarter stiffer than those of the person who was settled.
    moved = np.abs(episodes.observation().achieved_goal - before).reshape(6, 2, 4)
    assert moved[..., :3].max() < 0.02
    assert moved[..., 3].max() < math.radians(5)


@pytest.mark.parametrize(("off", "degrees"), [(0.049, 24.0), (0.051, 24.0), (0.049, 26.0)])
@pytest.mark.parametrize("arm", [0, 1])
def test_both_wrists_at_their_targets_and_both_elbows_straight(
    off: float, degrees: float, arm: int
) -> None:
    task = ArmStraighten(2)
    desired = np.array([0.6, -0.25, -0.07, 0.0, 0.6, 0.25, -0.07, 0.0])
    achieved = desired.copy()
    achieved[4 * arm + 1] += off
    achieved[4 * arm + 3] = math.radians(degrees)
    reached = off < 0.05 and math.radians(degrees) < STRAIGHT
    assert task.reward(achieved, desired) == (0.0 if reached else -1.0)
    dense = ArmStraighten(2, reward_type="dense").reward(achieved, desired)
    assert dense == pytest.approx(-off - 0.1 * math.radians(degrees))


def test_what_agents_see_of_the_arms() -> None:
    episodes = started(3)
    layout = episodes.simulation.keep(LimpPeople).layout
    bends = [layout.joint_qpos[f"{side}_elbow"][0] for side in ("right", "left")]
    np.testing.assert_allclose(
        seen(episodes, "elbow bend")[:, 0], episodes.simulation.qpos[0, bends], atol=1e-6
    )
    wrist, elbow = seen(episodes, "object position"), seen(episodes, "elbow position")
    # Arm 0 stands at the right arm, at -y.
    assert (wrist + BASES)[0, 1] < (wrist + BASES)[1, 1]
    goal = episodes.task.goal_layout.get(episodes.observation().achieved_goal, "object position")
    np.testing.assert_allclose(goal[0], wrist, atol=1e-6)
    tools = seen(episodes, "gripper position")
    relative = seen(episodes, "object position relative to the gripper")
    np.testing.assert_allclose(relative, wrist - tools, atol=1e-6)
    # The person moves as a whole: wrists with it, and at rest against the elbows.
    root = int(episodes.scene.model.joint("person").dofadr[0])
    episodes.simulation.qvel[0, root] = 0.3
    episodes.simulation.refresh()
    episodes._read()
    velocity = seen(episodes, "object linear velocity")
    np.testing.assert_allclose(velocity, [[0.3, 0.0, 0.0]] * 2, atol=1e-6)
    np.testing.assert_allclose(seen(episodes, "object angular velocity"), 0.0, atol=1e-6)
    assert (np.linalg.norm(wrist - elbow, axis=-1) > 0.2).all()


def test_a_force_above_its_limit_fails_the_episode() -> None:
    """A wrist that is squeezed between the hand and the bed."""
    episodes = started(5)
    assert episodes.task.hard == (*FORCE_COSTS, *TORQUE_COSTS)
    tool = episodes.scene.to_world(episodes.simulation.arm_state().tool_position)[0, 0]
    layout = episodes.simulation.keep(LimpPeople).layout
    episodes.simulation.qpos[0, layout.root_qpos[:3]] = tool - [0.0, 0.0, 0.05]
    result = episodes.step(IDLE[None])
    assert result.cost.item() > 0
    episodes.goal[:] = episodes.observation().achieved_goal
    assert not outcome(episodes).success.item()
    assert not started(5)._failed.any()


def test_copies_keep_people() -> None:
    episodes = begun(ENV_ID, 2, randomization="wide")
    episodes.step(np.full((2, 8), 0.1))
    copied = pickled_and_back(episodes)
    for _ in range(2):
        assert_same(
            vars(episodes.step(np.full((2, 8), 0.2))), vars(copied.step(np.full((2, 8), 0.2)))
        )


def test_every_agent_sees_its_own_arm() -> None:
    env = SaverParallelEnv(ENV_ID)
    first, second = env.reset(seed=3)[0].values()
    assert first.shape == second.shape == (38 + 4,)
    assert (first != second).any()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n_arms": 1}, "n_arms=1: must be exactly 2, one for each arm"),
        ({"person_body": 9}, "person_body=9: must be 0 to 7"),
        ({"success_threshold": 0.2}, "success_threshold=0.2: must be between 0 and 0.10 m"),
    ],
)
def test_bad_options(options: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        make_episodes(ENV_ID, **options)
