"""Kinematics and dynamics of the arms against MuJoCo, Pinocchio and the paper's tables."""

from __future__ import annotations

import math
import subprocess
import sys

import mujoco
import numpy as np
import pytest

from saver_envs.modelling import arms
from saver_envs.modelling.arms import arm_named
from saver_envs.modelling.chain import Chain
from saver_envs.modelling.dh import DHRow, chain_of_table
from saver_envs.modelling.mujoco_chain import chain_of_model, links_of_model
from saver_envs.modelling.newton_euler import Links, inverse_dynamics
from saver_envs.robots import JACO, MICO, Robot, fetch
from saver_envs.robots.description import Fingers
from saver_envs.robots.drives import torque_driven
from saver_envs.robots.fetch import FETCH
from saver_envs.scenes import Arms, compose
from saver_envs.simulation import Simulation

SITES = {"mico": "end_effector", "fetch": "tool"}
BASES = {"mico": "base", "fetch": fetch.BASE_BODY}
ROBOTS = {"mico": MICO, "fetch": FETCH}
CHAINS = {"mico": arms.mico.chain(), "fetch": arms.fetch.chain()}


@pytest.fixture(scope="module", params=["mico", "fetch"])
def arm(request: pytest.FixtureRequest) -> tuple[str, mujoco.MjModel, Chain]:
    model = torque_driven(ROBOTS[request.param]).compile()
    # Random postures may touch: what contacts and limits add is no inverse dynamics of the arm.
    for flag in (mujoco.mjtDisableBit.mjDSBL_CONTACT, mujoco.mjtDisableBit.mjDSBL_LIMIT):
        model.opt.disableflags |= int(flag)
    return request.param, model, CHAINS[request.param]


def motions(dof: int, n: int = 200) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    generator = np.random.default_rng(0)
    position = generator.uniform(-2, 2, (n, dof))
    return position, generator.normal(size=(n, dof)), generator.normal(size=(n, dof))


def test_forward_kinematics_and_jacobian_are_mujocos(
    arm: tuple[str, mujoco.MjModel, Chain],
) -> None:
    name, model, chain = arm
    data, site = mujoco.MjData(model), model.site(SITES[name]).id
    joints = motions(chain.dof)[0]
    frames = chain.frames(joints)
    jacobian = chain.jacobian(frames)
    linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    for row, posture in enumerate(joints):
        data.qpos[:] = posture
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacSite(model, data, linear, angular, site)
        assert np.abs(frames.tool_position[row] - data.site_xpos[site]).max() < 1e-9
        assert np.abs(jacobian[row] - np.concatenate([linear, angular])).max() < 1e-9


def test_newton_euler_is_mujocos_inverse(arm: tuple[str, mujoco.MjModel, Chain]) -> None:
    name, model, chain = arm
    links = links_of_model(model, BASES[name], ROBOTS[name].arm_joints, chain)
    position, velocity, acceleration = motions(chain.dof)
    torque = inverse_dynamics(chain, links, position, velocity, acceleration)
    data = mujoco.MjData(model)
    for row in range(len(position)):
        data.qpos[:], data.qvel[:], data.qacc[:] = position[row], velocity[row], acceleration[row]
        mujoco.mj_inverse(model, data)
        assert np.abs(torque[row] - data.qfrc_inverse).max() < 1e-9


def test_newton_euler_is_pinocchios(arm: tuple[str, mujoco.MjModel, Chain]) -> None:
    pinocchio = pytest.importorskip("pinocchio")
    name, model, chain = arm
    links = links_of_model(model, BASES[name], ROBOTS[name].arm_joints, chain)
    built = pinocchio.Model()
    parent = 0
    zero = chain.frames(np.zeros((1, chain.dof)))
    rotation, position = np.eye(3), np.zeros(3)
    for index in range(chain.dof):
        # Joint frames parallel to the links', at the anchors; axes as they are there.
        turned, anchor = zero.link_rotation[index, 0], zero.anchor[index, 0]
        placement = pinocchio.SE3(rotation.T @ turned, rotation.T @ (anchor - position))
        axis = turned.T @ zero.axis[index, 0]
        kind = pinocchio.JointModelPrismaticUnaligned if chain.prismatic[index] else None
        joint = (kind or pinocchio.JointModelRevoluteUnaligned)(axis)
        parent = built.addJoint(parent, joint, placement, f"joint_{index}")
        centre = links.centre[index] + turned.T @ (zero.link_position[index, 0] - anchor)
        inertia = pinocchio.Inertia(links.mass[index], centre, links.inertia[index])
        built.appendBodyToJoint(parent, inertia, pinocchio.SE3.Identity())
        rotation, position = turned, anchor
    data = built.createData()
    q, v, a = motions(chain.dof, 50)
    torque = inverse_dynamics(chain, links, q, v, a)
    for row in range(len(q)):
        assert (
            np.abs(torque[row] - pinocchio.rnea(built, data, q[row], v[row], a[row])).max() < 1e-9
        )


@pytest.mark.parametrize("robot", ["jaco", "mico", "fetch"])
def test_chains_read_off_a_model(robot: str) -> None:
    arm = arm_named(robot)
    model = arm.robot.build(Fingers.LOCKED).compile()
    chain = chain_of_model(model, arm.robot.base_body, arm.robot.arm_joints, arm.robot.tool_site)
    joints = motions(chain.dof, 50)[0]
    assert np.abs(chain.position(joints) - arm.tool_chain.position(joints)).max() < 1e-12
    if robot == "jaco":
        # Its home posture has the hand straight down.
        rotation = chain.frames(np.array([JACO.home])).tool_rotation[0]
        assert np.abs(rotation[:, 2] - (0, 0, 1)).max() < 1e-3


def test_tables_are_the_papers() -> None:
    alphas = [row.alpha for row in arms.mico.DH_TABLE]
    assert alphas == [0.0, -math.pi / 2, 0.0, -math.pi / 2]
    assert [row.a for row in arms.mico.DH_TABLE] == [0.0, 0.0, 0.29, 0.0]
    half, alphas = math.pi / 2, [row.alpha for row in arms.fetch.DH_TABLE]
    assert alphas == [
        0,
        -half,
        -half,
        half,
        -half,
        half,
        -half,
        0,
    ]
    assert arms.fetch.DH_TABLE[2].offset == -half
    lower, upper = arm_named("mico").lower, arm_named("mico").upper
    assert np.allclose(np.degrees(lower), (-180, 70, 155, -180))
    assert np.allclose(np.degrees(upper), (180, 200, 295, 180))
    for index, (low, high) in {1: (-23 / 45, 23 / 45), 2: (-7 / 18, 29 / 60)}.items():
        assert FETCH.joint_lower[index] == pytest.approx(low * math.pi, abs=2e-3)
        assert FETCH.joint_upper[index] == pytest.approx(high * math.pi, abs=2e-3)


def test_the_convention_matters() -> None:
    modified = chain_of_table(arms.fetch.DH_TABLE, "modified")
    joints = motions(8, 20)[0]
    assert np.abs(modified.position(joints) - CHAINS["fetch"].position(joints)).max() > 0.1
    with pytest.raises(ValueError, match="convention='craig'"):
        chain_of_table(arms.fetch.DH_TABLE, "craig")  # type: ignore[arg-type]


def test_a_pendulum_by_hand() -> None:
    # A point of 2 kg on a massless rod of 0.5 m, swinging about a level axis.
    chain = chain_of_table((DHRow(0.0, -math.pi / 2, 0.0),), "modified")
    links = Links(np.array([2.0]), np.array([[0.5, 0.0, 0.0]]), np.zeros((1, 3, 3)))
    torque = inverse_dynamics(
        chain, links, np.zeros((1, 1)), np.full((1, 1), 3.0), np.full((1, 1), 4.0)
    )
    # With the rod level, gravity pulls against a joint that turns it up.
    assert torque[0, 0] == pytest.approx(2 * 0.25 * 4.0 - 2 * 9.81 * 0.5)


@pytest.mark.parametrize("links", [arms.mico.appendix_links(), arms.fetch.appendix_links()])
def test_the_appendix_describes_bodies_that_can_exist(links: Links) -> None:
    for inertia in links.inertia:
        values = np.linalg.eigvalsh(inertia)
        assert values.min() > 0
        # A triangle's rule, to the figures' rounding.
        assert values[0] + values[1] >= 0.94 * values[2]


def test_the_appendix_is_near_the_makers_figures() -> None:
    model = torque_driven(MICO).compile()
    maker = links_of_model(model, "base", MICO.arm_joints, CHAINS["mico"])
    paper = arms.mico.appendix_links()
    assert np.abs(maker.centre - paper.centre).max() < 0.035
    assert np.allclose(maker.mass, paper.mass)


def test_the_fetch_comes_without_third_party_simulator_code() -> None:
    code = (
        "import sys; from saver_envs.robots.drives import torque_driven;"
        "from saver_envs.robots.fetch import FETCH; torque_driven(FETCH).compile();"
        "print([n for n in sys.modules if n.startswith('gymnasium_robotics.envs') or n == 'torch'])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=True
    )
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("robot", [MICO, FETCH])
def test_torque_driven_arms_have_motors_and_nothing_else(robot: Robot) -> None:
    model = torque_driven(robot).compile()
    limits = np.array(robot.joint_torque_limits)
    assert (model.nq, model.nu) == (len(limits), len(limits))
    assert np.allclose(model.actuator_forcerange[:, 1], limits)
    assert not model.dof_armature.any()
    assert not model.dof_damping.any()
    assert not model.dof_frictionloss.any()
    assert not model.body_gravcomp.any()


def test_the_fetch_in_a_scene() -> None:
    scene = compose(Arms(FETCH, 1, Fingers.LOCKED))
    simulation = Simulation(scene, 1)
    simulation.qpos[:, scene.joint_qpos[0]] = FETCH.home
    simulation.ctrl[:, scene.arm_ctrl[0]] = FETCH.home
    simulation.refresh()
    state = simulation.arm_state()
    frames = CHAINS["fetch"].frames(np.array([FETCH.home]))
    assert np.abs(state.tool_position[0, 0] - frames.tool_position[0]).max() < 1e-9
    assert np.abs(state.jacobian[0, 0] - CHAINS["fetch"].jacobian(frames)[0]).max() < 1e-9
    for _ in range(5):
        simulation.step(simulation.ctrl.copy(), False, None)
    assert np.abs(simulation.arm_state().joint_position[0, 0] - FETCH.home).max() < 1e-3


@pytest.mark.parametrize("joints", [np.zeros((3, 5)), np.zeros(4)])
def test_wrong_joints_are_named(joints: np.ndarray) -> None:
    with pytest.raises(ValueError, match="joints of shape"):
        CHAINS["mico"].frames(joints)


def test_wrong_dynamics_are_named() -> None:
    chain, links = CHAINS["mico"], arms.mico.appendix_links()
    with pytest.raises(ValueError, match="velocity of shape"):
        inverse_dynamics(chain, links, np.zeros((2, 4)), np.zeros((3, 4)), np.zeros((2, 4)))
    with pytest.raises(ValueError, match="links=8"):
        inverse_dynamics(chain, arms.fetch.appendix_links(), *np.zeros((3, 2, 4)))
