"""Our MICO against the maker's figures and the dissertation's DH table."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
from rollouts import cubes_of, objects_of, targets_of

from saver_envs.control import LEAD_LIMIT, DampedLeastSquares
from saver_envs.registration import make_episodes
from saver_envs.robots import MICO
from saver_envs.robots.description import Fingers
from saver_envs.robots.mico import END_EFFECTOR_SITE
from saver_envs.scenes import Arms, compose
from saver_envs.simulation import Simulation

# Lengths of the modified DH table (SPEC 4.1, Table 7.1), metres.
D1, A2, LATERAL, D4_END_EFFECTOR, D4_TOOL = 0.2755, 0.29, -0.007, 0.1231 + 0.16, 0.1231 + 0.188


def modified_dh(a: float, alpha: float, d: float, theta: float) -> np.ndarray:
    """Craig's transform from frame i - 1 to frame i."""
    ct, st, ca, sa = math.cos(theta), math.sin(theta), math.cos(alpha), math.sin(alpha)
    return np.array(
        [
            [ct, -st, 0, a],
            [st * ca, ct * ca, -sa, -d * sa],
            [st * sa, ct * sa, ca, d * ca],
            [0, 0, 0, 1],
        ]
    )


def chain(joints: np.ndarray, d4: float) -> np.ndarray:
    """Position of the point ``d4`` along the forearm. The table counts the angles otherwise than
    the maker: joint 1 turns the other way, joints 2 and 3 are zero with the arm level."""
    q1, q2, q3, q4 = joints
    frame = modified_dh(0, 0, D1, -q1)
    frame = frame @ modified_dh(0, -math.pi / 2, LATERAL, math.pi / 2 - q2)
    frame = frame @ modified_dh(A2, 0, 0, q3 + math.pi / 2)
    frame = frame @ modified_dh(0, -math.pi / 2, d4, q4)
    return frame[:3, 3]


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return MICO.build(Fingers.LOCKED).compile()


@pytest.mark.parametrize(
    ("site", "d4"), [(END_EFFECTOR_SITE, D4_END_EFFECTOR), (MICO.tool_site, D4_TOOL)]
)
def test_kinematics_are_those_of_the_dh_table(model: mujoco.MjModel, site: str, d4: float) -> None:
    data = mujoco.MjData(model)
    generator = np.random.default_rng(0)
    for joints in generator.uniform(-math.pi, math.pi, (200, 4)):
        data.qpos[:] = joints
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(data.site(site).xpos, chain(joints, d4), atol=1e-9)


def test_joint_4_does_not_move_the_tool(model: mujoco.MjModel) -> None:
    data = mujoco.MjData(model)
    positions = []
    for angle in (0.0, 1.0, -2.5):
        data.qpos[:] = (0.3, 3.0, 2.0, angle)
        mujoco.mj_kinematics(model, data)
        positions.append(data.site(MICO.tool_site).xpos.copy())
    np.testing.assert_allclose(positions, positions[:1] * 3, atol=1e-12)


def test_tool_axes_are_the_bases_when_the_hand_points_down(model: mujoco.MjModel) -> None:
    data = mujoco.MjData(model)
    shoulder = math.pi - 0.5
    data.qpos[:] = (0.0, shoulder, math.pi + shoulder, 0.0)
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(data.site(MICO.tool_site).xmat.reshape(3, 3), np.eye(3), atol=1e-12)


def test_masses_are_the_makers(model: mujoco.MjModel) -> None:
    maker = {"base": 0.46784, "link_1": 0.7477, "link_2": 0.85968, "link_3": 0.606, "link_4": 0.78}
    for body, mass in maker.items():
        assert model.body(body).mass[0] == pytest.approx(mass, abs=1e-9)
    fingers = [model.body(index).name for index in range(model.nbody)]
    fingers = [name for name in fingers if name.startswith("finger")]
    assert len(fingers) == 4
    assert all(model.body(name).mass[0] == pytest.approx(0.01) for name in fingers)


def test_limits_are_the_makers(model: mujoco.MjModel) -> None:
    ranges = np.degrees(model.jnt_range)
    np.testing.assert_allclose(ranges[1:3], [(50, 310), (35, 325)])
    assert model.jnt_limited.tolist() == [False, True, True, False]
    np.testing.assert_allclose(model.actuator_forcerange[:, 1], [40, 80, 40, 20])
    np.testing.assert_allclose(model.jnt_actfrcrange[:, 1], [40, 80, 40, 20])
    np.testing.assert_allclose(np.degrees(MICO.joint_speed_limits), [36, 36, 36, 48])


def test_fingers_mirror_one_another() -> None:
    model = MICO.build(Fingers.ACTUATED).compile()
    data = mujoco.MjData(model)
    for angle in (MICO.finger_open, 0.7, MICO.finger_closed):
        data.qpos[:] = (*MICO.home, angle, angle)
        mujoco.mj_kinematics(model, data)
        tool = data.site(MICO.tool_site)
        to_tool = tool.xmat.reshape(3, 3).T
        first, second = (
            to_tool @ (data.geom(f"distal_{index}").xpos - tool.xpos) for index in (1, 2)
        )
        np.testing.assert_allclose(first * (1, -1, 1), second, atol=1e-12)


def test_the_closed_hand_is_shut_and_stays_clear_of_the_table_at_its_lowest() -> None:
    model = MICO.build(Fingers.LOCKED).compile()
    data = mujoco.MjData(model)
    data.qpos[:] = (0.0, math.pi - 0.5, 2 * math.pi - 0.5, 0.0)  # straight down
    mujoco.mj_kinematics(model, data)
    gap = mujoco.mj_geomDistance(
        model, data, model.geom("distal_1").id, model.geom("distal_2").id, 0.1, None
    )
    assert abs(gap) < 1e-3
    tool = data.site(MICO.tool_site).xpos[2]
    for name in ("distal_1", "distal_2"):
        geom, shape = data.geom(name), model.geom(name)
        lowest = geom.xpos[2] - shape.size[0] - shape.size[1] * abs(geom.xmat[8])
        assert tool - lowest < 0.020


def test_least_squares_turns_an_idle_joint_back() -> None:
    scene = compose(Arms(MICO, 1, Fingers.LOCKED))
    simulation = Simulation(scene, 1)
    joints = np.add(MICO.home, (0.0, 0.0, 0.0, 0.2))
    simulation.qpos[:, scene.joint_qpos[0]] = joints
    simulation.refresh()
    state = simulation.arm_state()
    wanted = DampedLeastSquares(MICO)(state, state.tool_position)
    np.testing.assert_allclose(wanted[0, 0], MICO.home, atol=1e-9)


@pytest.mark.parametrize("env_id", ["MicoPush-v0", "MicoPickAndPlace-v0"])
def test_the_tool_follows_its_set_point_and_comes_to_rest_on_it(env_id: str) -> None:
    episodes = make_episodes(env_id, n=8)
    for index in range(episodes.n):
        episodes.set_generator(index, np.random.default_rng(index))
    episodes.reset()
    cubes = cubes_of(episodes).qpos[0, :2]
    episodes.simulation.qpos[:, cubes] = (-0.5, 0.9)  # out of the way
    episodes.simulation.refresh()
    actions = np.zeros((episodes.n, episodes.action_size))
    directions = np.random.default_rng(0).normal(size=(episodes.n, 3))
    directions[:, 0] = -abs(directions[:, 0])  # towards the base: nothing stretches
    actions[:, :3] = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    for step in range(20):
        if step == 8:
            actions[:] = 0
        outcome = episodes.step(actions)
        tool = episodes.simulation.arm_state().tool_position
        error = np.linalg.norm(tool - episodes.set_point, axis=-1)
        assert error.max() < 0.012 < LEAD_LIMIT
        assert not outcome.measured["cost_collision"].any()
    assert error.max() < 0.002
    assert np.linalg.norm(episodes.simulation.arm_state().tool_velocity, axis=-1).max() < 1e-3


def test_set_points_keep_the_hand_steep() -> None:
    episodes = make_episodes("MicoPush-v0", n=4)
    for index in range(episodes.n):
        episodes.set_generator(index, np.random.default_rng(index))
    episodes.reset()
    episodes.simulation.qpos[:, cubes_of(episodes).qpos[0, :2]] = (-0.5, 0.9)
    episodes.simulation.refresh()
    outwards = np.array([[1.0, 0, 0], [0.7, 0.7, 0], [0.7, -0.7, 0], [0, 1, 0]])
    for _ in range(40):
        outcome = episodes.step(outwards)
        assert not outcome.measured["cost_collision"].any()
    shoulder = np.array([0, 0, MICO.shoulder_height])
    reach = np.linalg.norm(episodes.simulation.arm_state().tool_position - shoulder, axis=-1)
    assert reach.max() < MICO.hand_reach + 0.005


@pytest.mark.parametrize(
    "env_id", ["MicoPush-v0", "MicoPickAndPlace-v0", "DualMicoPush-v0", "DualMicoPickAndPlace-v0"]
)
def test_every_id_finds_starts_within_reach(env_id: str) -> None:
    episodes = make_episodes(env_id, n=50)
    for index in range(episodes.n):
        episodes.set_generator(index, np.random.default_rng(index))
    episodes.reset()
    for points in (objects_of(episodes).position, targets_of(episodes)):
        assert np.hypot(points[..., 0], points[..., 1]).max() <= MICO.reach + 1e-9
    for _ in range(3):
        outcome = episodes.step(np.zeros((episodes.n, episodes.action_size)))
        assert not outcome.diverged.any()
        assert not outcome.measured["cost_collision"].any()
