"""Leg straighten: starts, what agents see of the person's legs, and when legs are straight."""

from __future__ import annotations

import math
import re
from functools import partial

import mujoco
import numpy as np
import pytest
import rollouts
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from rollouts import assert_same, begun, pickled_and_back, seen_part, settled_anew, touching

from saver_envs.episodes import Episodes
from saver_envs.people.limp_people import LimpPeople
from saver_envs.registration import make_episodes
from saver_envs.tasks.care_starts import alone, settled
from saver_envs.tasks.leg_straighten import STRAIGHT, LegStraighten
from saver_envs.tasks.leg_straighten_starts import ASIDE, PAIRS, kinds_of, stays

ENV_ID = "LegStraighten-v0"
IDLE = np.zeros(6)
BASES = np.array([[0.0, -0.36, 0.0], [0.0, 0.36, 0.0]])

started = partial(rollouts.started, ENV_ID)


def seen(episodes: Episodes, name: str) -> NDArray[np.float64]:
    """Return a part of the observation (arms, size), in its unit."""
    return seen_part(episodes, name)[0]


@given(seed=st.integers(0, 2**31))
def test_a_start_keeps_the_rules(seed: int) -> None:
    episodes = started(seed)
    assert not touching(episodes, np.arange(1)).any()
    targets = episodes.targets()[0]
    assert np.linalg.norm(targets[1] - targets[0]) == pytest.approx(2 * ASIDE, abs=0.02)
    # A nearly straight leg reaches there.
    ankle, knee, hip = (seen(episodes, f"{name} position") for name in ("object", "knee", "hip"))
    leg = np.linalg.norm(knee - hip, axis=-1) + np.linalg.norm(ankle - knee, axis=-1)
    reach = np.linalg.norm(targets - BASES - hip, axis=-1)
    np.testing.assert_allclose(reach / leg, math.cos(math.radians(2.5)), atol=2e-3)


def test_every_pair_of_kinds_has_its_postures() -> None:
    pairs = [kinds_of(index) for index in range(LegStraighten.postures)]
    assert {pair: pairs.count(pair) for pair in pairs} == dict.fromkeys(PAIRS, 4)


@pytest.mark.parametrize("who", [0, 3, 6])
def test_settled_legs_lie_as_their_kind_says(who: int) -> None:
    bed, world = LegStraighten.bed, alone(who, LegStraighten.bed)
    for index, pose in enumerate(settled("leg straighten")[who]):
        world.data.qpos[world.layout.qpos] = pose
        mujoco.mj_kinematics(world.model, world.data)
        for side, kind in zip(("left", "right"), kinds_of(index), strict=True):
            assert stays(world, bed, side, kind), (index, side, kind)


def test_a_settled_start_is_what_the_task_settles() -> None:
    task, who, index = LegStraighten(2), 3, 1
    pose = settled_anew(task, who, index)
    np.testing.assert_allclose(settled(task.name)[who, index], pose, atol=5e-3)


def test_a_person_rests() -> None:
    """On the most slippery sheet."""
    episodes = begun(ENV_ID, 12, bed_friction=0.15)
    before = episodes.observation().achieved_goal
    for _ in range(25):
        result = episodes.step(np.tile(IDLE, (12, 1)))
    assert not result.measured["cost_collision"].any()
    assert result.cost.max() == 0.0
    moved = np.abs(episodes.observation().achieved_goal - before).reshape(12, 2, 4)
    assert moved[..., :3].max() < 0.02
    assert moved[..., 3].max() < math.radians(5)


@pytest.mark.parametrize(("off", "degrees"), [(0.049, 14.0), (0.051, 14.0), (0.049, 16.0)])
@pytest.mark.parametrize("arm", [0, 1])
def test_both_ankles_at_their_targets_and_both_knees_straight(
    off: float, degrees: float, arm: int
) -> None:
    task = LegStraighten(2)
    desired = np.array([0.4, 0.26, -0.04, 0.0, 0.4, -0.26, -0.04, 0.0])
    achieved = desired.copy()
    achieved[4 * arm + 1] += off
    achieved[4 * arm + 3] = math.radians(degrees)
    reached = off < 0.05 and math.radians(degrees) < STRAIGHT
    assert task.reward(achieved, desired) == (0.0 if reached else -1.0)
    dense = LegStraighten(2, reward_type="dense").reward(achieved, desired)
    assert dense == pytest.approx(-off - 0.1 * math.radians(degrees))


def test_what_agents_see_of_the_legs() -> None:
    episodes = started(3)
    layout = episodes.simulation.keep(LimpPeople).layout
    bends = [layout.joint_qpos[f"{side}_knee"][0] for side in ("left", "right")]
    np.testing.assert_allclose(
        seen(episodes, "knee bend")[:, 0], episodes.simulation.qpos[0, bends], atol=1e-6
    )
    ankle, knee, hip = (seen(episodes, f"{name} position") for name in ("object", "knee", "hip"))
    # Arm 0 stands at the left leg, at -y; feet are nearer to the arms than hips.
    assert (hip + BASES)[0, 1] < (hip + BASES)[1, 1]
    assert (ankle[:, 0] < hip[:, 0]).all()
    # Each arm sees in its own frame where the other leg is.
    for own, name in ((ankle, "other ankle position"), (knee, "other knee position")):
        np.testing.assert_allclose(seen(episodes, name) + BASES, (own + BASES)[::-1], atol=1e-6)


def test_copies_keep_people() -> None:
    episodes = begun(ENV_ID, 2, randomization="wide")
    episodes.step(np.full((2, 6), 0.1))
    copied = pickled_and_back(episodes)
    for _ in range(2):
        assert_same(
            vars(episodes.step(np.full((2, 6), 0.2))), vars(copied.step(np.full((2, 6), 0.2)))
        )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n_arms": 1}, "n_arms=1: must be exactly 2, one for each leg"),
        ({"person_body": 9}, "person_body=9: must be 0 to 7"),
        ({"bed_friction": 2.0}, "bed_friction=2.0: must be 0.02 to 1.5"),
    ],
)
def test_bad_options(options: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        make_episodes(ENV_ID, **options)
