"""Our UR10e against the maker's figures: what it is, where it reaches, and how strong it is."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from saver_envs.control import DampedLeastSquares, SetPointRule, Workspace
from saver_envs.reachability import ReachabilityMap, reachability_map
from saver_envs.robots import UR10E
from saver_envs.robots.description import Fingers
from saver_envs.robots.ur10e import PAYLOAD, REACH
from saver_envs.scenes import Arms, compose
from saver_envs.simulation import ACTION_DURATION, Simulation

Array = NDArray[np.float64]

#: The maker's table: a, d (m), alpha (rad); mass (kg) and centre of mass (m) of each link.
ROWS = (
    (0.0, 0.1807, math.pi / 2, 7.369, (0.021, 0.0, 0.027)),
    (-0.6127, 0.0, 0.0, 13.051, (0.38, 0.0, 0.158)),
    (-0.57155, 0.0, 0.0, 3.989, (0.24, 0.0, 0.068)),
    (0.0, 0.17415, math.pi / 2, 2.1, (0.0, 0.007, 0.018)),
    (0.0, 0.11985, -math.pi / 2, 1.98, (0.0, 0.007, 0.018)),
    (0.0, 0.11655, 0.0, 0.615, (0.0, 0.0, -0.026)),
)
#: Torques (N m) and speeds (degrees per second), the maker's.
TORQUES, SPEEDS = (330, 330, 150, 56, 56, 56), (120, 120, 180, 180, 180, 180)
#: From the flange to the tool (m), ahead of it and below it.
TOOL = (0.10, 0.0, 0.07)


def frames(joints: Array) -> list[Array]:
    """Return the frame (4, 4) at the end of every link, by the standard DH convention."""
    frame, found = np.diag([-1.0, -1.0, 1.0, 1.0]), []  # the stretched arm points along x
    for (a, d, alpha, _, _), angle in zip(ROWS, joints, strict=True):
        ct, st, ca, sa = math.cos(angle), math.sin(angle), math.cos(alpha), math.sin(alpha)
        step = [
            [ct, -st * ca, st * sa, a * ct],
            [st, ct * ca, -ct * sa, a * st],
            [0.0, sa, ca, d],
            [0.0, 0.0, 0.0, 1.0],
        ]
        frame = frame @ np.array(step)
        found.append(frame)
    return found


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return UR10E.build(Fingers.LOCKED).compile()


@pytest.fixture(scope="module")
def grid() -> ReachabilityMap:
    return reachability_map(UR10E)


def test_links_are_where_the_makers_table_says(model: mujoco.MjModel) -> None:
    data = mujoco.MjData(model)
    for joints in np.random.default_rng(0).uniform(-math.pi, math.pi, (100, 6)):
        data.qpos[:] = joints
        mujoco.mj_kinematics(model, data)
        ends = frames(joints)
        for index, (end, (*_, centre)) in enumerate(zip(ends, ROWS, strict=True), start=1):
            place = (end @ [*centre, 1.0])[:3]
            body = model.body(f"link_{index}").id
            np.testing.assert_allclose(data.xipos[body], place, atol=1e-9)
        tool = data.site(UR10E.tool_site)
        np.testing.assert_allclose(tool.xpos, (ends[-1] @ [*TOOL, 1])[:3], atol=1e-9)
        # The tool's z axis points back, into the hand.
        np.testing.assert_allclose(tool.xmat[[2, 5, 8]], -ends[-1][:3, 2], atol=1e-9)


def test_masses_and_limits_are_the_makers(model: mujoco.MjModel) -> None:
    masses = [model.body(f"link_{index}").mass[0] for index in range(1, 7)]
    np.testing.assert_allclose(masses, [row[3] for row in ROWS])
    hand = model.body("hand").mass[0]
    assert model.body_mass.sum() - hand == pytest.approx(33.5, abs=0.01)
    np.testing.assert_allclose(np.degrees(UR10E.joint_speed_limits), SPEEDS)
    np.testing.assert_allclose(model.jnt_actfrcrange, np.array([(-one, one) for one in TORQUES]))
    np.testing.assert_allclose(model.actuator_forcerange, model.jnt_actfrcrange)


def test_inertia_is_the_makers(model: mujoco.MjModel) -> None:
    """Of the upper arm, whose axes are those of the printed frame: along it, and across."""
    body = model.body("link_2").id
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[body])
    axes = turn.reshape(3, 3)
    tensor = axes @ np.diag(model.body_inertia[body]) @ axes.T
    printed = [[0.0281, 0.0001, -0.0156], [0.0001, 0.7707, 0.0], [-0.0156, 0.0, 0.7694]]
    np.testing.assert_allclose(tensor, printed, atol=1e-9)


def test_it_holds_its_payload_at_its_reach() -> None:
    """Stretched out level, the wrist as well: the flange is 1.3 m ahead."""
    spec = UR10E.build(Fingers.LOCKED)
    load = spec.body("hand").add_body(name="load")  # its centre at the flange
    load.mass, load.inertia, load.explicitinertial = PAYLOAD, (0.05, 0.05, 0.05), True
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = data.ctrl[:] = (0.0, 0.0, 0.0, -math.pi / 2, 0.0, 0.0)
    mujoco.mj_forward(model, data)
    assert data.body("load").xpos[0] == pytest.approx(REACH, abs=0.01)
    mujoco.mj_step(model, data, 1500)
    assert np.abs(data.qpos - data.ctrl).max() < math.radians(1.0)
    assert np.abs(data.qvel).max() < 1e-3
    torque = np.abs(data.qfrc_actuator)
    assert (torque < np.array(TORQUES)).all()
    # Nearly all of its strength: gravity is not taken away from the joints' limits.
    assert torque[1] > 0.75 * TORQUES[1]


def test_it_presses_with_130_newtons_all_over_its_workspace(grid: ReachabilityMap) -> None:
    """In every direction, besides carrying itself, wherever its tool can be held."""
    model = UR10E.build(Fingers.LOCKED).compile()
    model.body_gravcomp[:] = 0
    data, jacobian = mujoco.MjData(model), np.zeros((3, 6))
    postures = grid.postures[grid.vertex_reached]
    assert len(postures) > 800
    directions = np.concatenate([np.eye(3), -np.eye(3)])
    strong = []
    for joints in postures:
        data.qpos[:], data.qvel[:] = joints, 0.0
        mujoco.mj_forward(model, data)
        mujoco.mj_jacSite(model, data, jacobian, None, model.site(UR10E.tool_site).id)
        torque = data.qfrc_bias + 130.0 * directions @ jacobian
        strong.append((np.abs(torque) <= np.array(TORQUES)).all())
    assert np.mean(strong) == 1.0


def driven(simulation: Simulation, set_point: Array, target: Array, actions: int) -> Array:
    """Drive the tools to targets (n, 3) as episodes do, at 0.5 m/s; return the set-points."""
    solve, n = DampedLeastSquares(UR10E), simulation.n
    lower, upper = (np.array([corner]) for corner in (UR10E.grid_lower, UR10E.grid_upper))
    lower = lower - [0, 0, 0.10]
    longest = 0.5 * ACTION_DURATION
    rule = SetPointRule(Workspace(lower, upper), longest)
    for _ in range(actions):
        state = simulation.arm_state()
        motion = np.clip((target[:, None] - set_point) / longest, -1, 1)
        set_point = rule.moved(set_point, motion, state.tool_position)
        targets = simulation.ctrl.copy()
        targets[:, simulation.scene.arm_ctrl] = solve(state, set_point)
        assert not simulation.step(targets).any()
    assert set_point.shape == (n, 1, 3)
    return set_point


def started(grid: ReachabilityMap, points: Array) -> Simulation:
    simulation = Simulation(compose(Arms(UR10E, 1, Fingers.LOCKED)), len(points))
    joints = grid.postures_at(points)[:, None]
    simulation.reset(np.arange(len(points)), joints, np.zeros((len(points), 1, 0)))
    simulation.refresh()
    return simulation


def test_it_reaches_all_over_its_workspace(grid: ReachabilityMap) -> None:
    """Through set-points, damped least squares and servos; the tool stays upright."""
    generator = np.random.default_rng(0)
    points = generator.uniform(UR10E.grid_lower, UR10E.grid_upper, (400, 3))
    points = points[grid.reachable(points)]
    assert len(points) > 250
    start, target = points[:48], points[48:96]
    simulation = started(grid, start)
    driven(simulation, start[:, None].copy(), target, 120)
    state = simulation.arm_state()
    away = np.linalg.norm(state.tool_position[:, 0] - target, axis=-1)
    turned = np.abs(state.tool_rotation[:, 0] - np.eye(3)).max(axis=(1, 2))
    assert away.max() < 1e-3
    assert turned.max() < 1e-3
    assert np.abs(state.joint_velocity).max() < 0.01


@pytest.mark.parametrize("ahead", [0.5, 0.75, 1.0])
def test_it_presses_on_the_table(grid: ReachabilityMap, ahead: float) -> None:
    """By a set-point below it, as far as set-points may lead."""
    point = np.array([[ahead, 0.1, 0.03]])
    simulation = started(grid, point)
    driven(simulation, point[:, None].copy(), point - [0, 0, 0.08], 50)
    model = simulation.model_of(0)
    data = mujoco.MjData(model)
    simulation.copy_into(0, data)
    mujoco.mj_forward(model, data)
    force = np.zeros(6)
    total = 0.0
    for index in range(data.ncon):
        mujoco.mj_contactForce(model, data, index, force)
        total += force[0]
    assert total > 150.0
    assert (np.abs(data.qfrc_actuator[:6]) <= np.array(TORQUES) + 1e-6).all()
    assert np.abs(simulation.qvel).max() < 0.02
