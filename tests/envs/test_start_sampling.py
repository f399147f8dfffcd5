"""Where things are at the start of an episode: every rule of the specification, whatever the seed.

The rules stand here once more in plain figures and are checked on the simulation's own state, not
with the sampler's code.
"""

from __future__ import annotations

from itertools import pairwise

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from rollouts import (
    CUBE_IDS,
    SPARSE_IDS,
    begun,
    cubes_of,
    objects_of,
    started,
    targets_of,
    touching,
)

from saver_envs.episodes import Episodes
from saver_envs.registration import ENVIRONMENTS, make_episodes
from saver_envs.tasks.push import PUSH_HEIGHT
from saver_envs.tasks.sampling import CLEARANCE_WIDTHS
from saver_envs.tasks.table import TableTask, _sampler

SEEDS = st.integers(0, 2**31)
#: Greatest horizontal distance of objects and targets from the base (m).
REACH = {"jaco": 0.62, "mico": 0.48}
EPS = 1e-9


def places(episodes: Episodes) -> tuple[NDArray[np.float64], ...]:
    """Return hands, objects and targets (arms, 3) in base frames, as they are simulated."""
    simulation = episodes.simulation
    hand = simulation.arm_state().tool_position[0]
    return hand, objects_of(episodes).position[0], targets_of(episodes)[0]


def world(episodes: Episodes, points: NDArray[np.float64]) -> NDArray[np.float64]:
    scene = episodes.scene
    return np.einsum("aij,aj->ai", scene.base_rotation, points) + scene.base_position


def cubes_on_table_alone(model: mujoco.MjModel, data: mujoco.MjData) -> bool:
    """Say whether the only contacts are those of cubes with the table."""
    pairs = [{model.geom(int(geom)).name for geom in contact.geom} for contact in data.contact]
    cubes = {f"object{arm}" for arm in range(4)}
    return all("table" in pair and len(pair & cubes) == 1 for pair in pairs)


@pytest.mark.parametrize("env_id", CUBE_IDS)
@given(seed=SEEDS)
def test_regions_distances_and_reach(env_id: str, seed: int) -> None:
    episodes = started(env_id, seed)
    row, task = ENVIRONMENTS[env_id], episodes.task
    hand, objects, target = places(episodes)
    for points in (objects, target):
        assert (points[:, 0] >= 0.30 - EPS).all()
        assert (points[:, 0] <= 0.55 + EPS).all()
        assert (np.hypot(points[:, 0], points[:, 1]) <= REACH[row.robot] + EPS).all()
        if row.n_arms == 1:
            assert (np.abs(points[:, 1]) <= 0.42 + EPS).all()
        else:  # from 0.10 m outside the base line to a little beyond the middle line
            beyond = 0.36 + episodes.task.overlap
            assert (points[:, 1] >= [-0.10 - EPS, -beyond - EPS]).all()
            assert (points[:, 1] <= [beyond + EPS, 0.10 + EPS]).all()
    assert (hand[:, 0] >= 0.25 - 1e-3).all()
    assert (hand[:, 0] <= 0.60 + 1e-3).all()
    assert (hand[:, 2] >= 0.02 - 1e-3).all()
    assert (hand[:, 2] <= 0.40 + 1e-3).all()
    to_object = np.linalg.norm(hand - objects, axis=-1)
    assert (to_object >= 0.10 - 1e-3).all()
    assert (to_object <= 0.20 + 1e-3).all()
    to_target = np.linalg.norm(objects - target, axis=-1)
    assert (to_target >= 0.10 - EPS).all()
    assert (to_target <= 0.25 + EPS).all()
    np.testing.assert_allclose(objects[:, 2], 0.028)
    assert (target[:, 2] >= 0.028 - EPS).all()
    assert (target[:, 2] <= (0.028 if task.name == "push" else 0.25) + EPS).all()


@pytest.mark.parametrize("env_id", [one for one in CUBE_IDS if ENVIRONMENTS[one].n_arms > 1])
@given(seed=SEEDS)
def test_objects_and_targets_keep_apart(env_id: str, seed: int) -> None:
    episodes = started(env_id, seed)
    _, objects, target = places(episodes)
    points = np.concatenate([world(episodes, objects), world(episodes, target)])
    apart = np.linalg.norm(points[:, None] - points[None], axis=-1)
    assert (apart[np.triu_indices(len(points), 1)] >= 1.5 * 0.056 - EPS).all()


@pytest.mark.parametrize("env_id", ["DualJacoPush-v0", "DualMicoPush-v0"])
@given(seed=SEEDS)
def test_no_arm_has_room_for_all_of_anothers_push(env_id: str, seed: int) -> None:
    """Behind the cube at its start, or 5 cm before its target, another arm's hand cannot be."""
    episodes = started(env_id, seed)
    _, objects, target = places(episodes)
    way = (target - objects) / np.linalg.norm(target - objects, axis=-1, keepdims=True)
    behind = world(episodes, objects - (0.028 + 0.03) * way)
    at_end = world(episodes, target - (0.028 + 0.03 + 0.05) * way)
    box = episodes.task.workspace(episodes.scene.arms)
    reach = REACH[ENVIRONMENTS[env_id].robot] - 0.04  # surely within it
    for arm in range(2):
        rotation, base = episodes.scene.base_rotation[arm], episodes.scene.base_position[arm]
        seen = (np.stack([behind[1 - arm], at_end[1 - arm]]) - base) @ rotation
        within = ((seen >= box.lower[arm]) & (seen <= box.upper[arm]))[:, :2].all(axis=1)
        assert not (within & (np.hypot(seen[:, 0], seen[:, 1]) <= reach)).all()


@given(seed=SEEDS)
def test_the_distance_task_starts_and_ends_within_the_band(seed: int) -> None:
    episodes = started("DualJacoDistance-v0", seed)
    _, objects, target = places(episodes)
    for points in (objects, target):
        first, second = world(episodes, points)
        assert abs(np.linalg.norm(first - second) - 0.35) <= 0.015
    seen = episodes.observation()
    assert seen.desired_goal[0, -1] == np.float32(0.35)
    assert abs(seen.achieved_goal[0, -1] - 0.35) <= 0.015
    assert not episodes._failed.any()


@pytest.mark.parametrize("env_id", CUBE_IDS)
@given(seed=SEEDS)
def test_nothing_is_solved_nor_touches_anything(env_id: str, seed: int) -> None:
    """No object within eps of its target; the only contacts are those of cubes on the table."""
    episodes = started(env_id, seed)
    seen = episodes.observation()
    task = episodes.task
    for arm in range(task.n_arms):
        part = slice(3 * arm, 3 * arm + 3)
        gap = seen.achieved_goal[0, part] - seen.desired_goal[0, part]
        assert np.linalg.norm(gap) > task.success_threshold
    model = episodes.scene.model
    data = mujoco.MjData(model)
    episodes.simulation.copy_into(0, data)
    mujoco.mj_forward(model, data)
    assert cubes_on_table_alone(model, data)


@pytest.mark.parametrize("env_id", SPARSE_IDS)
@given(seed=SEEDS)
def test_hands_are_where_they_were_drawn(env_id: str, seed: int) -> None:
    """To 1 mm, within the joints' limits, at rest, and held there by the servos."""
    episodes = started(env_id, seed)
    state = episodes.simulation.arm_state()
    np.testing.assert_allclose(state.tool_position, episodes.set_point, atol=1e-3)
    np.testing.assert_array_equal(state.joint_velocity, 0)
    robot = episodes.settings.robot
    assert (state.joint_position >= np.asarray(robot.joint_lower)).all()
    assert (state.joint_position <= np.asarray(robot.joint_upper)).all()
    controls = episodes.simulation.ctrl[:, episodes.scene.arm_ctrl]
    np.testing.assert_array_equal(controls, state.joint_position)


@pytest.mark.parametrize("env_id", [one for one in CUBE_IDS if "PickAndPlace" in one])
def test_half_of_the_pick_and_place_targets_are_in_the_air(env_id: str) -> None:
    n = 256
    heights = targets_of(begun(env_id, n))[..., 2]
    share = (heights > 0.03).mean()
    assert abs(share - 0.5) < 0.15
    assert heights.max() > 0.2


@pytest.mark.parametrize("env_id", [one for one in CUBE_IDS if ENVIRONMENTS[one].n_arms > 1])
def test_something_lies_in_the_overlap_in_a_fifth_of_the_episodes(env_id: str) -> None:
    """An object or a target lies on the far side of the middle line or near enough to it."""
    episodes = begun(env_id, 200)
    overlap = episodes.task.overlap
    objects = objects_of(episodes).world_position
    target = episodes.targets()
    inside = np.abs(np.concatenate([objects, target], axis=1)[..., 1]) <= overlap
    assert inside.any(axis=1).mean() >= 0.20


def crosses(first: NDArray[np.float64], second: NDArray[np.float64]) -> bool:
    """Say whether two ways (2, 2), from x and y to x and y, cross."""

    def side(way: NDArray[np.float64], point: NDArray[np.float64]) -> float:
        along, lever = way[1] - way[0], point - way[0]
        return float(along[0] * lever[1] - along[1] * lever[0])

    return all(
        side(way, other[0]) * side(way, other[1]) < 0
        for way, other in ((first, second), (second, first))
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("env_id", "n_arms"),
    [
        ("DualJacoPush-v0", 2),
        ("DualJacoPickAndPlace-v0", 3),
        *(
            pytest.param(env_id, n_arms, marks=pytest.mark.long)
            for env_id, n_arms in (
                *(("DualJacoPush-v0", 3), ("DualJacoPush-v0", 4)),
                *(("DualJacoPickAndPlace-v0", 2), ("DualJacoPickAndPlace-v0", 4)),
            )
        ),
    ],
)
def test_neighbours_ways_cross_in_the_promised_share_of_starts(env_id: str, n_arms: int) -> None:
    for share, least, most in ((0.0, 0.0, 0.01), (0.4, 0.26, 0.54), (1.0, 0.98, 1.0)):
        episodes = make_episodes(env_id, n_arms=n_arms, contested_share=share)
        task, scene = episodes.task, episodes.scene
        crossed = 0
        for seed in range(100):
            start = task.sample(np.random.default_rng(seed), scene)
            ways = np.stack([scene.to_world(start.object), scene.to_world(start.target)], axis=1)
            pairs = pairwise(ways[..., :2])
            crossed += any(crosses(first, second) for first, second in pairs)
        assert least <= crossed / 100 <= most, share


@pytest.mark.parametrize("env_id", CUBE_IDS)
def test_cubes_of_nine_centimetres_start_untouched(env_id: str) -> None:
    """Those of the physical push runs."""
    episodes = begun(env_id, 24, object_size=0.09)
    model = episodes.scene.model
    data = mujoco.MjData(model)
    for row in range(episodes.n):
        episodes.simulation.copy_into(row, data)
        mujoco.mj_forward(model, data)
        assert cubes_on_table_alone(model, data)


def test_touching_sees_what_it_should() -> None:
    episodes = begun("DualJacoPush-v0", 4)
    simulation, scene = episodes.simulation, episodes.scene
    tools = episodes.scene.to_world(simulation.arm_state().tool_position)
    simulation.qpos[0, cubes_of(episodes).qpos[0, :3]] = tools[0, 0]  # in the hand
    simulation.qpos[1, cubes_of(episodes).qpos[0, :3]] = simulation.qpos[
        1, cubes_of(episodes).qpos[1, :3]
    ]
    simulation.qpos[2, scene.joint_qpos[0, 1]] += 0.6  # an arm on or in the table
    assert touching(episodes, np.arange(4)).tolist() == [True, True, True, False]
    assert touching(episodes, np.array([3, 0])).tolist() == [False, True]


#: Object and target of two arms (x, y), in metres: which of the arms can go first.
WAYS = {
    "ways apart": (((0.0, 0.0), (0.3, 0.0)), ((0.0, 0.4), (0.3, 0.4)), True),
    "only the first: its target is clear of the second's way, and its own way is clear": (
        *(((0.0, 0.0), (0.3, 0.0)), ((0.15, 0.3), (0.15, 0.02)), True),
    ),
    "only the second": (((0.15, 0.3), (0.15, 0.02)), ((0.0, 0.0), (0.3, 0.0)), True),
    "the second's object lies in the first's way, and its target in the second's way": (
        *(((0.0, 0.0), (0.3, 0.0)), ((0.15, 0.0), (0.45, 0.0)), True),
    ),
    "each object lies in the other's way": (
        *(((0.0, 0.0), (0.3, 0.0)), ((0.2, 0.0), (-0.2, 0.0)), False),
    ),
    "each target lies in the other's way": (
        *(((0.0, 0.0), (0.3, 0.0)), ((0.5, 0.0), (0.2, 0.0)), False),
    ),
    "first: target in the way; second: object in the way": (
        *(((0.0, 0.0), (0.3, 0.0)), ((0.3, 0.3), (0.0, -0.3)), None),
    ),
}


@pytest.mark.parametrize("name", WAYS)
def test_one_of_two_arms_can_go_first(name: str) -> None:
    first, second, expected = WAYS[name]
    episodes = make_episodes("DualJacoPush-v0")
    assert isinstance(episodes.task, TableTask)
    sampler = _sampler(episodes.task, episodes.scene)
    ways = np.zeros((2, 1, 2, 3))
    ways[0, 0, :, :2], ways[1, 0, :, :2] = first, second
    found = bool(sampler._one_can_go_first(ways[0], ways[1])[0])
    assert found == bool(sampler._one_can_go_first(ways[1], ways[0])[0]), "either order"
    clear = CLEARANCE_WIDTHS * episodes.task.object_size

    def gap(point: tuple[float, float], way: tuple[tuple[float, float], ...]) -> float:
        along = np.linspace(way[0], way[1], 2001)
        return float(np.linalg.norm(along - point, axis=-1).min())

    by_hand = [
        gap(other[0], own) >= clear and gap(own[1], other) >= clear
        for own, other in ((first, second), (second, first))
    ]
    assert found == any(by_hand)
    assert expected in (None, found)


def test_a_pitched_hand_has_room_behind_a_high_cube() -> None:
    """Its wrist, which is nearer to the base the further the hand reaches, does not meet it."""
    episodes = make_episodes("DualMicoPush-v0", 40, object_size=0.09)
    for index in range(40):
        episodes.set_generator(index, np.random.default_rng(index))
    episodes.reset()
    cube, target = objects_of(episodes).position, targets_of(episodes)
    way = (target - cube)[..., :2]
    way /= np.linalg.norm(way, axis=-1, keepdims=True)
    hand = cube[..., :2] - (0.045 + 0.03) * way
    away = np.linalg.norm(hand, axis=-1)
    inward = np.maximum(-np.sum(hand * way, axis=-1) / away, 0)
    hand -= (0.55 * np.maximum(away - 0.375, 0) * inward)[..., None] * way
    reach = np.sqrt(0.565**2 - (0.2755 - PUSH_HEIGHT) ** 2)
    assert (np.linalg.norm(hand, axis=-1) <= reach + EPS).all()
    assert (inward > 0.5).any()  # it matters in some of them
