"""Keyword arguments do what they say, seen in the compiled model and in the motion."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rollouts import assert_same, begun, cubes_of, objects_of, random_actions, touching

from saver_envs.episodes import JOINT_LEAD, LONGEST_EPISODE, Episodes
from saver_envs.reachability import reachability_map
from saver_envs.registration import default_options, make_episodes
from saver_envs.scenes import BASE_SPACING


def test_objects() -> None:
    episodes = make_episodes(
        "DualJacoPush-v0",
        object_size=0.09,
        object_mass=0.35,
        object_friction=0.61,
        object_damping=0.2,
    )
    model = episodes.scene.model
    for arm in range(2):
        geom = model.geom(f"object{arm}")
        np.testing.assert_allclose(geom.size, 0.045)
        assert geom.friction[0] == 0.61
        assert model.body(f"object{arm}").mass == pytest.approx(0.35)
        damping = model.joint(f"object{arm}_joint").damping
        np.testing.assert_allclose(damping[:3], 0.2)
        np.testing.assert_allclose(damping[3:], 0.2 * 0.09**2 / 6)
    episodes.reset()
    np.testing.assert_allclose(objects_of(episodes).position[..., 2], 0.045)


def test_horizon_threshold_and_clock() -> None:
    env = gymnasium.make("JacoPush-v0", max_episode_steps=3, success_threshold=0.02)
    env.reset(seed=0)
    assert [env.step(np.zeros(3))[3] for _ in range(3)] == [False, False, True]
    goal = np.zeros(3)
    assert env.unwrapped.compute_reward(np.array([0.019, 0, 0]), goal, {}) == 0
    assert env.unwrapped.compute_reward(np.array([0.021, 0, 0]), goal, {}) == -1


def speeds(episodes: Episodes, steps: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Move at full speed, with a change of mind now and then, as long as nothing is hit.

    :return: speeds of the hands (m/s), and of the joints as shares of the makers' limits.
    """
    limits = np.asarray(episodes.settings.robot.joint_speed_limits)
    hands, joints = [], []
    free = np.ones(episodes.n, dtype=bool)
    held = random_actions(episodes.action_size, steps // 10 + 1, episodes.n, seed=1)
    for step in range(steps):
        episodes.step(np.sign(held[step // 10]))
        free &= ~touching(episodes, np.arange(episodes.n))
        state = episodes.simulation.arm_state()
        hands.append(np.linalg.norm(state.tool_velocity[free], axis=-1))
        joints.append((np.abs(state.joint_velocity) / limits)[free].max(axis=-1))
    return np.concatenate(hands).reshape(-1), np.concatenate(joints).reshape(-1)


@pytest.mark.parametrize("env_id", ["JacoPickAndPlace-v0", "MicoPickAndPlace-v0"])
@pytest.mark.parametrize("control", ["cartesian", "joints"])
def test_rated_setting(env_id: str, control: str) -> None:
    """Makers' limits: 0.2 m/s and the joints' speeds, 125 actions.

    The limits hold for set-points and for the servos' targets. What moves freely may exceed them
    while it catches up, hands and, where joints are the action, joints seldom by more than a
    tenth. The worst is an arm stretched out all of whose joints turn back at once.
    """
    episodes = begun(env_id, 16, rated=True, control=control)
    assert episodes.settings.horizon == 125
    assert episodes.settings.max_speed == 0.2
    hands, joints = speeds(episodes, 60)
    assert len(hands) > 200
    assert joints.max() >= 0.5  # the arms do move
    if control == "cartesian":
        assert joints.max() <= 1.10
        assert np.percentile(hands, 95) <= 0.22
    else:
        assert np.percentile(joints, 98) <= 1.10
        assert joints.max() <= 1.6


@pytest.mark.parametrize("rated", [False, True])
def test_joint_targets_do_not_run_away_from_a_blocked_arm(rated: bool) -> None:
    """Else it would press ever on after the command has turned, and shoot off when it is free."""
    episodes = begun("JacoPush-v0", 1, control="joints", rated=rated)
    down = np.zeros((1, 6))
    down[0, 1] = 1
    ahead = []
    for _ in range(40):
        collided = episodes.step(down).measured["cost_collision"][0]
        state = episodes.simulation.arm_state()
        targets = episodes.simulation.ctrl[:, episodes.scene.arm_ctrl]
        ahead.append(np.abs(targets - state.joint_position).max())
    assert collided
    assert max(ahead) <= JOINT_LEAD + 0.05


@pytest.mark.parametrize("direction", [-1, 1])
def test_joint_targets_stay_within_the_limits_of_the_joints(direction: int) -> None:
    robot = make_episodes("JacoPush-v0").scene.robot
    limit = np.array(robot.joint_upper if direction > 0 else robot.joint_lower)
    for joint in np.flatnonzero(np.isfinite(limit)):
        episodes = begun("JacoPush-v0", 1, control="joints")
        scene, simulation = episodes.scene, episodes.simulation
        simulation.qpos[0, scene.joint_qpos[0, joint]] = limit[joint] - direction * 0.01
        simulation.ctrl[0, scene.arm_ctrl[0, joint]] = limit[joint] - direction * 0.01
        episodes._read()
        action = np.zeros((1, episodes.action_size))
        action[0, joint] = direction
        episodes.step(action)
        assert simulation.ctrl[0, scene.arm_ctrl[0, joint]] == limit[joint]


@pytest.mark.parametrize("speed", [0.1, 0.3, 0.5])
def test_max_speed(speed: float) -> None:
    episodes = begun("JacoPickAndPlace-v0", 8, max_speed=speed)
    up = np.tile([0.0, 0, 1, 0], (8, 1))
    start = episodes.set_point.copy()
    for _ in range(5):
        before = episodes.set_point.copy()
        episodes.step(up)
        moved = np.linalg.norm(episodes.set_point - before, axis=-1)
        assert moved == pytest.approx(speed * 0.04)
    climbed = episodes.simulation.arm_state().tool_position - start
    assert climbed[..., 2] == pytest.approx(5 * speed * 0.04, rel=0.15)


def test_joint_control() -> None:
    episodes = begun("DualJacoPush-v0", 1, control="joints")
    assert episodes.action_size == 12
    before = episodes.simulation.arm_state().joint_position
    action = np.zeros((1, 12))
    action[0, 0], action[0, 6 + 3] = 0.5, -0.5
    for _ in range(5):
        episodes.step(action)
    moved = episodes.simulation.arm_state().joint_position - before
    assert moved[0, 0, 0] > 0.05
    assert moved[0, 1, 3] < -0.05
    assert np.abs(np.delete(moved.reshape(-1), [0, 9])).max() < 0.02


@pytest.mark.parametrize("n_arms", [1, 3, 4])
@pytest.mark.parametrize("layout", ["row", "ring"])
@pytest.mark.parametrize("env_id", ["DualJacoPush-v0", "JacoPickAndPlace-v0"])
def test_number_of_arms(env_id: str, n_arms: int, layout: Any) -> None:
    env = gymnasium.make(env_id, n_arms=n_arms, layout=layout, max_episode_steps=5)
    assert env.observation_space["observation"].shape == (28 * n_arms,)
    assert env.observation_space["desired_goal"].shape == (3 * n_arms,)
    size = (3 if "Push" in env_id else 4) * n_arms
    assert env.action_space.shape == (size,)
    env.reset(seed=0)
    for action in random_actions(size, 5, 1)[:, 0]:
        seen, _, _, truncated, info = env.step(action)
    assert seen in env.observation_space
    assert truncated
    assert not info["diverged"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n_arms": 5}, "1 to 4"),
        ({"n_arms": 0}, "1 to 4|exactly|n_arms"),
        ({"layout": "heap"}, "'row' or 'ring'"),
        ({"control": "mind"}, "'cartesian' or 'joints'"),
        ({"max_episode_steps": 0}, "1 to 1000000"),
        ({"max_speed": 0}, "max_speed"),
        ({"success_threshold": 0.5}, "success_threshold"),
        ({"object_size": 0.4}, "object_size=0.4: must be 0.035 to 0.12 m"),
        ({"object_mass": 0}, "object_mass"),
        ({"object_friction": -1}, "object_friction"),
        ({"object_damping": float("nan")}, "object_damping"),
        ({"object_friction": 1e300}, "object_friction=1e.300: must be 0 to 10"),
        ({"object_mass": 1e300}, "object_mass=1e.300: must be 0.001 to 100 kg"),
        ({"object_size": "0.05"}, "object_size='0.05': must be a finite number"),
        ({"object_size": True}, "object_size=True: must be a finite number"),
        ({"contested_share": 1.1}, "contested_share=1.1: must be 0 to 1"),
        ({"contested_share": float("nan")}, "contested_share=nan: must be a finite number"),
        ({"max_episode_steps": 1.5}, "max_episode_steps=1.5: must be a whole number"),
        ({"max_episode_steps": float("inf")}, "max_episode_steps=inf: must be a whole number"),
        ({"max_episode_steps": True}, "max_episode_steps=True: must be a whole number"),
        ({"max_episode_steps": 10**400}, "max_episode_steps=10+: must be 1 to 1000000 actions"),
        ({"n_arms": 1.0}, "n_arms=1.0: must be a whole number"),
        ({"rated": "yes"}, "rated='yes': must be True or False"),
        ({"rated": 1}, "rated=1: must be True or False"),
        ({"bounded_observations": None}, "bounded_observations=None: must be True or False"),
        ({"max_speed": 1 + 1j}, "max_speed=.1.1j.: must be a finite number"),
        ({"n": 0}, "n=0: must be at least 1"),
        ({"n": 2.0}, "n=2.0: must be a whole number"),
        ({"threads": "2"}, "threads='2': must be a whole number"),
    ],
)
def test_options_out_of_range(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_episodes("JacoPush-v0", **options)


def test_episodes_are_one_by_default() -> None:
    made = make_episodes("JacoPush-v0")
    assert Episodes(made.task, made.settings).n == made.n == 1


def test_numbers_of_numpy_are_numbers() -> None:
    task = make_episodes(
        "JacoPush-v0",
        max_episode_steps=np.int64(7),
        rated=np.True_,
        object_mass=np.float32(0.25),
        object_damping=0,
    ).task
    assert (task.object_mass, task.object_damping) == (0.25, 0)


OPTIONS = sorted(default_options("DualJacoPush-v0"))
#: What people and files pass by mistake.
ODD = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.complex_numbers(),
    st.text(max_size=5),
    st.binary(max_size=3),
    st.lists(st.floats(), max_size=3),
    st.builds(object),
)


@given(st.sampled_from(OPTIONS), ODD)
@settings(max_examples=300)
def test_an_option_is_accepted_or_refused_by_name(name: str, value: Any) -> None:
    """Nothing but a valid value gets through, and no other error is raised than the one of it."""
    try:
        episodes = make_episodes("DualJacoPush-v0", **{name: value})
    except ValueError as error:
        assert str(error).startswith(f"{name}={value!r}: must be ")
        return
    default = default_options("DualJacoPush-v0")[name]
    if isinstance(default, bool):
        assert isinstance(value, bool)
    elif name == "randomization":
        assert value is None or isinstance(value, str)
    elif isinstance(default, str):
        assert isinstance(value, str)
    elif value is not None:
        assert isinstance(value, int | float)
        assert not isinstance(value, bool)
        assert np.isfinite(float(value))
    assert 1 <= episodes.settings.horizon <= LONGEST_EPISODE
    assert 1 <= episodes.task.n_arms <= 4


@pytest.mark.parametrize(
    ("env_id", "option"),
    [
        ("JacoPush-v0", "reward_stage"),
        ("JacoPickAndPlace-v0", "constraint_weight"),
        ("JacoPush-v0", "in_hand_probability"),
        ("DualJacoDistance-v0", "contested_share"),
        ("WristPush-v0", "object_size"),
        ("WristPush-v0", "layout"),
    ],
)
def test_options_of_another_task_are_unknown(env_id: str, option: str) -> None:
    message = f"{env_id} got an unexpected keyword argument '{option}'.*valid keywords are .*rated"
    with pytest.raises(TypeError, match=message):
        make_episodes(env_id, **{option: 0.5})


def test_reward_stages_of_the_distance_task() -> None:
    assert make_episodes("DualJacoDistance-v0").task.reward_stage == "constrained"
    assert make_episodes("DualJacoDistance-v0", reward_stage="goal").task.reward_stage == "goal"
    with pytest.raises(ValueError, match="exactly 2"):
        make_episodes("DualJacoDistance-v0", n_arms=3)
    with pytest.raises(ValueError, match="layout='ring': must be 'row'"):
        make_episodes("DualJacoDistance-v0", layout="ring")
    with pytest.raises(ValueError, match="one of goal, constrained"):
        make_episodes("DualJacoDistance-v0", reward_stage="both")
    with pytest.raises(ValueError, match="reward_combination='max'"):
        make_episodes("DualJacoDistance-v0", reward_combination="max")
    with pytest.raises(ValueError, match="constraint_weight=0"):
        make_episodes("DualJacoDistance-v0", constraint_weight=0)


def test_bases_stand_where_the_layout_says() -> None:
    row = make_episodes("DualJacoPush-v0").scene
    np.testing.assert_allclose(row.base_position, [(0, -0.36, 0), (0, 0.36, 0)])
    assert BASE_SPACING == 0.72
    ring = make_episodes("DualJacoPush-v0", n_arms=4, layout="ring").scene
    centre = ring.base_position.mean(axis=0)
    towards_centre = centre - ring.base_position
    facing = ring.base_rotation[..., 0]  # each base's x axis
    np.testing.assert_allclose(
        facing, towards_centre / np.linalg.norm(towards_centre, axis=-1, keepdims=True), atol=1e-12
    )


def test_observations_do_not_depend_on_where_a_base_stands() -> None:
    """The same hands, cubes and actions in base frames look the same from every place of a ring.

    Contact-free, since friction is not isotropic to the last digit. Also that arms which cannot
    reach one another do not influence one another.
    """
    ring = begun("JacoPickAndPlace-v0", 1, n_arms=4, layout="ring")
    alone = begun("JacoPickAndPlace-v0", 1)
    hand = np.array([0.42, 0.10, 0.18])
    cube = np.array([0.40, -0.10, 0.028])
    turn = np.array([np.cos(0.3), 0, 0, np.sin(0.3)])  # about z
    for episodes in (ring, alone):
        scene, arms = episodes.scene, episodes.task.n_arms
        joints = reachability_map(episodes.settings.robot).postures_at(hand[None])[0]
        fingers = np.full((1, *scene.finger_qpos.shape), episodes.settings.robot.finger_open)
        position = episodes.scene.to_world(np.tile(cube, (1, arms, 1)))
        yaw = np.arctan2(scene.base_rotation[:, 1, 0], scene.base_rotation[:, 0, 0]) / 2
        base = np.stack([np.cos(yaw), 0 * yaw, 0 * yaw, np.sin(yaw)], axis=-1)
        w = base[:, 0] * turn[0] - base[:, 3] * turn[3]
        z = base[:, 0] * turn[3] + base[:, 3] * turn[0]
        quaternion = np.stack([w, 0 * w, 0 * w, z], axis=-1)
        objects = np.concatenate([position[0], quaternion], axis=-1)[None]
        postures = np.tile(joints, (1, arms, 1))
        episodes.simulation.reset(np.arange(1), postures, fingers)
        episodes.simulation.qpos[:, cubes_of(episodes).qpos] = objects
        episodes.simulation.refresh()
        episodes.set_point[:] = hand
        episodes._read()
    for step in range(10):
        action = 0.3 * np.sin(step + np.arange(4.0))
        ring.step(np.tile(action, 4)[None])
        alone.step(action[None])
        block = alone.observation().observation[0]
        for seen in ring.observation().observation[0].reshape(4, 28):
            np.testing.assert_allclose(seen, block, atol=2e-6)
    np.testing.assert_allclose(block[18:22], turn, atol=1e-5)


def test_episodes_of_one_batch_do_not_influence_one_another() -> None:
    """A row of a large batch is the row of a small one."""
    large = begun("DualJacoPickAndPlace-v0", 9, seed=3)
    small = begun("DualJacoPickAndPlace-v0", 2, seed=7)
    for action in random_actions(8, 25, 9):
        large.step(action)
        small.step(action[4:6])
        assert_same(large.observation().observation[4:6], small.observation().observation)


def test_starts_in_hand() -> None:
    episodes = begun("JacoPickAndPlace-v0", 6, in_hand_probability=1.0)
    hand, cube = episodes.simulation.arm_state().tool_position, objects_of(episodes)
    assert (np.linalg.norm(hand - cube.position, axis=-1) < 0.05).all()
    closed = np.tile([0.0, 0, 0, -1], (6, 1))
    for _ in range(15):
        episodes.step(closed)
    cube = objects_of(episodes)
    assert (cube.position[..., 2] > 0.03).all()
