"""Wrist push: where the person lies, what the wrists read, what the torso may be put through."""

from __future__ import annotations

from functools import partial
from typing import Any

import gymnasium
import mujoco
import numpy as np
import pytest
import rollouts
from gymnasium.utils.env_checker import check_env
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from rollouts import assert_same, begun, objects_of, random_actions, touching

from saver_envs.cameras.rgbd import BENCH_POSE, KINECT_V2
from saver_envs.episodes import Episodes
from saver_envs.people.bench import person_addresses
from saver_envs.people.bodies import BODIES
from saver_envs.people.manikin import joint_centres
from saver_envs.people.patient import Patient, people_in
from saver_envs.registration import make_episodes
from saver_envs.tasks.wrist_push import WristPush

ENV_ID = "WristPush-v0"
IDLE = np.zeros((1, 6))

started = partial(rollouts.started, ENV_ID)


def drawn(episodes: Episodes, row: int = 0) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return an episode's own model, and data that are up to date."""
    model = episodes.simulation.model_of(row)
    data = mujoco.MjData(model)
    data.qpos[:] = episodes.simulation.qpos[row]
    mujoco.mj_forward(model, data)
    return model, data


def skeleton(episodes: Episodes) -> NDArray[np.float64]:
    return joint_centres(*drawn(episodes))


@given(seed=st.integers(0, 2**31))
def test_a_start_keeps_the_rules(seed: int) -> None:
    """SPEC 5.6, on the simulation's own state."""
    episodes = started(seed)
    joints = skeleton(episodes)
    # Right before left, as the arms stand.
    wrists, hips = joints[[4, 7]], joints[[8, 11]]
    middle = hips.mean(axis=0)
    assert abs(middle[0] - 0.35) <= 0.05 + 0.005  # the mesh's hips are a little off its origin
    assert abs(middle[1]) <= 0.03 + 0.005
    assert joints[1, 0] < middle[0] - 0.3  # the head towards -x
    target = episodes.targets()[0]
    beside = target - hips
    np.testing.assert_allclose(np.linalg.norm(beside[:, :2], axis=-1), 0.15, atol=1e-6)
    assert beside[0, 1] < -0.14
    assert beside[1, 1] > 0.14
    away = np.linalg.norm(wrists - target, axis=-1)
    assert (away >= 0.10 - 1e-6).all()
    assert (away <= 0.25 + 1e-6).all()
    bases = np.array([[0.0, -0.36, 0.0], [0.0, 0.36, 0.0]])
    assert (np.linalg.norm((wrists - bases)[:, :2], axis=-1) <= 0.48).all()
    pixels, _ = KINECT_V2.project(wrists, BENCH_POSE)
    assert (pixels >= 0).all()
    assert (pixels <= [KINECT_V2.width, KINECT_V2.height]).all()
    hand = episodes.simulation.arm_state().tool_position[0]
    to_wrist = np.linalg.norm(hand + bases - wrists, axis=-1)
    assert (to_wrist >= 0.10 - 2e-3).all()
    assert (to_wrist <= 0.20 + 2e-3).all()
    assert not touching(episodes, np.arange(1)).any()


def test_arms_lie_where_they_start() -> None:
    """Nothing floats or sinks in: wrists stay within millimetres, and nothing is pressed."""
    episodes = begun(ENV_ID, 8)
    before = objects_of(episodes).position
    for _ in range(25):
        outcome = episodes.step(np.zeros((8, 6)))
    assert np.abs(objects_of(episodes).position - before).max() < 0.012
    assert not outcome.measured["cost_collision"].any()
    np.testing.assert_allclose(outcome.measured["torso_force"], 0)
    assert outcome.measured["torso_displacement"].max() < 1e-3


def test_people_differ() -> None:
    episodes = begun(ENV_ID, 24)
    people = people_in(episodes.memory)
    assert len(set(people.body.tolist())) > 6
    masses = {float(episodes.simulation.model_of(row).body("torso").mass[0]) for row in range(24)}
    assert len(masses) == len(set(people.body.tolist()))
    for values in (people.hips[:, 0], people.yaw, people.friction, people.stiffness):
        assert len(set(values.tolist())) == 24
    statures = [body.stature for body in BODIES]
    assert min(statures) < 1.62 < 1.78 < max(statures)


def test_what_the_wrists_read() -> None:
    """Positions are the skeleton's, velocities their differences; x points along the forearm."""
    episodes = begun(ENV_ID, 1)
    push = np.array([[0.3, 0.6, 0.0, 0.3, -0.6, 0.0]])
    for _ in range(10):
        episodes.step(push)
    before = objects_of(episodes)
    model, data = drawn(episodes)
    joints = joint_centres(model, data)
    np.testing.assert_allclose(before.world_position[0], joints[[4, 7]], atol=1e-9)
    forearm = joints[[4, 7]] - joints[[3, 6]]
    forearm /= np.linalg.norm(forearm, axis=-1, keepdims=True)
    for arm in range(2):
        matrix = np.empty(9)
        mujoco.mju_quat2Mat(matrix, before.quaternion[0, arm])
        axes = matrix.reshape(3, 3)
        np.testing.assert_allclose(axes[:, 0], forearm[arm], atol=1e-9)
        assert abs(axes[2, 1]) < 1e-12
        assert before.quaternion[0, arm, 0] >= 0
    episodes.simulation._batch.step(None, 1, 2)
    after = objects_of(episodes)
    moved = (after.position - before.position) / 0.002
    np.testing.assert_allclose(moved, after.linear_velocity, atol=5e-3)


def test_costs_and_success_remember_the_torso() -> None:
    """A push of the trunk moves it and costs; the episode succeeds no more, goal or not."""
    episodes = begun(ENV_ID, 2, control="joints")
    address = person_addresses(episodes.scene).trunk_qpos[1]
    episodes.simulation.qpos[0, address] += 0.021
    idle = np.zeros((2, episodes.action_size))
    outcome = episodes.step(idle)
    assert outcome.measured["cost_torso_displacement"].tolist() == [1, 0]
    assert outcome.cost.tolist() == [1, 0]
    np.testing.assert_allclose(outcome.measured["torso_displacement"][0], 0.021, atol=2e-3)
    episodes.simulation.qpos[0, address] -= 0.021
    episodes.goal[:] = episodes.observation().achieved_goal
    outcome = episodes.step(idle)
    assert outcome.measured["cost_torso_displacement"].tolist() == [0, 0]
    assert outcome.reached.tolist() == [True, True]
    assert outcome.reward.tolist() == [0, 0]
    assert outcome.success.tolist() == [False, True]


def test_a_hand_on_the_trunk_is_measured() -> None:
    """Both as a force and as a collision, and equal to what MuJoCo says of the contacts."""
    episodes = begun(ENV_ID, 1)
    trunk = person_addresses(episodes.scene).trunk_qpos
    model, data = drawn(episodes)
    tool = data.site_xpos[episodes.scene.tool_site[1]]
    beside = data.geom("torso_1").xpos
    gap = tool[1] - beside[1] - float(model.geom("torso_1").size[0])
    episodes.simulation.qpos[0, trunk[1]] += gap + 0.06
    episodes.simulation.qpos[0, trunk[0]] += tool[0] - beside[0]
    outcome = episodes.step(IDLE)
    assert outcome.measured["cost_collision"].tolist() == [1]
    assert outcome.measured["torso_force"][0] > 50
    assert outcome.measured["cost_torso_force"].tolist() == [1]
    assert not outcome.success.any()


def test_limits_are_those_of_the_specification(monkeypatch: pytest.MonkeyPatch) -> None:
    task = WristPush(2)
    goal = np.zeros((4, 6))
    episodes = make_episodes(ENV_ID, 4)
    patient = episodes.simulation.keep(Patient)
    monkeypatch.setattr(
        patient,
        "readings",
        lambda memory: {
            "torso_force": np.array([49.9, 50.1, 0, 0]),
            "torso_displacement": np.array([0, 0, 0.0199, 0.0201]),
        },
    )
    measured = task.measure(episodes.simulation, episodes.memory, goal, goal)
    assert measured["cost_torso_force"].tolist() == [0, 1, 0, 0]
    assert measured["cost_torso_displacement"].tolist() == [0, 0, 0, 1]
    assert task.reward(goal, goal).tolist() == [0, 0, 0, 0]  # the goal alone
    assert episodes.settings.horizon == 250
    assert make_episodes(ENV_ID, rated=True).settings.max_speed == 0.2


def test_going_back_to_a_state_brings_back_the_people() -> None:
    episodes = begun(ENV_ID, 3)
    for action in random_actions(6, 20, 3):
        episodes.step(action)
    state = episodes.get_state()
    ahead = [vars(episodes.step(action)) for action in random_actions(6, 10, 3, seed=2)]
    episodes.reset()
    episodes.set_state(state)
    assert_same([vars(episodes.step(a)) for a in random_actions(6, 10, 3, seed=2)], ahead)


@pytest.mark.parametrize(
    "options",
    [
        {"object_size": 0.07},
        {"object_friction": 0.1},
        {"layout": "ring"},
        {"in_hand_probability": 0.5},
    ],
)
def test_options_of_cubes_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(TypeError, match=next(iter(options))):
        make_episodes(ENV_ID, **options)


def test_pixels_are_a_sound_environment() -> None:
    env = gymnasium.make("WristPushPixels-v0", max_episode_steps=3).unwrapped
    check_env(env, skip_render_check=True)
    env.close()


def test_pixels_show_the_episode_behind() -> None:
    """The newest of 30 pictures a second, from the camera over the bench; rewards are the same."""
    env = gymnasium.make("WristPushPixels-v0", depth_noise=False)
    behind = gymnasium.make(ENV_ID)
    seen, info = env.reset(seed=3)
    behind.reset(seed=3)
    assert set(seen) == {"rgb", "depth"}
    assert seen["rgb"].shape == (424, 512, 3)
    assert seen["rgb"].dtype == np.uint8
    assert seen["depth"].shape == (424, 512)
    assert seen["depth"].dtype == np.float32
    assert info["picture_age"] == 0
    # In the picture's corner is the bench, 1.2 m below the camera.
    np.testing.assert_allclose(seen["depth"][5, 5], 1.20, atol=2e-3)
    episodes = env.unwrapped.episodes  # type: ignore[attr-defined]
    wrist = objects_of(episodes).world_position[0, 1]
    pixel, depth = KINECT_V2.project(wrist, BENCH_POSE)
    column, row = np.floor(pixel).astype(int)
    assert 0 < depth - seen["depth"][row, column] < 0.06  # the skin is above the joint
    ages = []
    for action in random_actions(6, 6, 1)[:, 0]:
        seen, *result, info = env.step(action)
        ages.append(info.pop("picture_age"))
        assert_same((*result, info), behind.step(action)[1:])
    np.testing.assert_allclose(ages[:5], [0.04 - 1 / 30, 0.08 - 2 / 30, 0.02, 0.16 - 4 / 30, 0])
    assert seen in env.observation_space
    env.close()
