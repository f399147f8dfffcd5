"""Solvers, learned inverse kinematics behind the environments' seam, and the action wrapper."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import gymnasium
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import saver_envs  # noqa: F401  (registers the ids)
from saver_envs.control import DampedLeastSquares
from saver_envs.modelling.arms import ARMS, arm_named, mico
from saver_envs.modelling.chain import FloatArray
from saver_envs.modelling.datasets import campaign_of
from saver_envs.modelling.dynamics import LearnedInverseDynamics, tracking_error
from saver_envs.modelling.kinematics import LearnedInverseKinematics
from saver_envs.modelling.models import ADVERSARIAL, Training, new_model
from saver_envs.modelling.models.base import InverseModel
from saver_envs.modelling.networks import MLPArchitecture
from saver_envs.modelling.shipped import shipped_model
from saver_envs.modelling.solvers import evaluate, nearest, newton, reach, rotation_of
from saver_envs.modelling.trajectories import random_trajectory
from saver_envs.modelling.twin import Twin
from saver_envs.modelling.workspace import within, workspace_samples
from saver_envs.registration import make_episodes
from saver_envs.wrappers.learned_ik import LearnedIKAction

SHOULDER = np.array([0.0, 0.0, mico.DH_TABLE[0].d])
#: The MICO's reach from its shoulder (m): both links stretched out, 7 mm beside the axis.
REACH = float(np.hypot(0.29 + 0.1231 + mico.TOOL, mico.DH_TABLE[2].d))


class Wild(type(new_model("mlp", "mico", "ik"))):  # type: ignore[misc]
    """A model whose answers are far beyond the limits."""

    def predict(self, inputs: FloatArray, present: FloatArray | None = None) -> FloatArray:
        return np.full((len(inputs), self.output_size), 40.0)


@pytest.mark.parametrize("model", [None, "gan"])
@pytest.mark.parametrize("robot", ARMS)
def test_shipped_models_meet_unseen_targets(robot: str, model: str | None) -> None:
    unseen = workspace_samples(robot, 1500, 77)
    learned = LearnedInverseKinematics(robot, model)
    assert (learned.model.name in ADVERSARIAL) == (model == "gan")
    raw = LearnedInverseKinematics(robot, model, refinement=0).solve(unseen.targets)
    refined = learned.solve(unseen.targets)
    millimetres = refined.error * 1e3
    assert np.median(millimetres) < 2
    assert np.percentile(millimetres, 99) < 10
    assert np.median(raw.error) < 0.02
    assert refined.reachable.mean() > 0.99
    assert (refined.joints >= learned.arm.joint_lower).all()
    assert (refined.joints <= learned.arm.joint_upper).all()


@pytest.mark.parametrize("robot", ARMS)
def test_workspace_samples_are_targets_that_their_joints_reach(robot: str) -> None:
    arm = arm_named(robot)
    samples = workspace_samples(robot, 300, 0)
    assert samples.targets.shape == (300, arm.target_size)
    assert within(arm, samples.targets).all()
    assert evaluate(samples.targets, samples.joints, arm.tool_chain).reachable.all()
    again = workspace_samples(robot, 300, 0)
    assert np.array_equal(samples.joints, again.joints)


def test_rotation_vectors() -> None:
    turn = rotation_of(np.array([[0.0, 0.0, np.pi / 2], [0.0, 0.0, 0.0]]))
    assert np.allclose(turn[0] @ (1, 0, 0), (0, 1, 0))
    assert np.allclose(turn[1], np.eye(3))


@pytest.mark.parametrize("robot", ARMS)
def test_newton_steps_converge(robot: str) -> None:
    arm = arm_named(robot)
    samples = workspace_samples(robot, 200, 1)
    start = samples.joints + 0.02
    errors = [
        np.median(
            evaluate(
                samples.targets,
                newton(arm, samples.targets, start, steps, arm.tool_chain),
                arm.tool_chain,
            ).error
        )
        for steps in range(4)
    ]
    assert errors[1] < 0.2 * errors[0]
    assert errors[3] < 1e-6


def test_newton_steps_keep_the_limits() -> None:
    arm = arm_named("fetch")
    samples = workspace_samples("fetch", 300, 2)
    start = samples.joints.copy()
    start[:, 0] = arm.joint_upper[0]  # the lift is up: it can only go down
    joints = newton(arm, samples.targets, start, 4, arm.tool_chain)
    assert (joints >= arm.joint_lower).all()
    assert (joints <= arm.joint_upper).all()
    assert evaluate(samples.targets, joints, arm.tool_chain).reachable.mean() > 0.9


@settings(max_examples=15, deadline=None)
@given(st.floats(-1.2, 1.2), st.floats(-0.6, 1.2), st.floats(0.7, 3.0))
def test_out_of_reach_the_nearest_point_is_found(turn: float, rise: float, far: float) -> None:
    direction = np.array([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)])
    target = (SHOULDER + far * direction)[None]
    learned = LearnedInverseKinematics("mico")
    solution = learned.solve(target, np.array([[0.0, 2.2499, 4.7966, 0.0]]))
    assert not solution.reachable[0]
    assert np.isfinite(solution.joints).all()
    assert (solution.joints >= learned.arm.joint_lower).all()
    assert (solution.joints <= learned.arm.joint_upper).all()
    # The nearest point of a ball lies on the way to its centre.
    assert solution.error[0] == pytest.approx(far - REACH, abs=2e-3)


@settings(max_examples=15, deadline=None)
@given(st.lists(st.floats(-50, 50), min_size=3, max_size=3))
def test_any_target_gives_joints_within_the_limits(point: list[float]) -> None:
    for robot in ("mico", "jaco"):
        learned = LearnedInverseKinematics(robot)
        home = np.asarray(learned.arm.robot.home)[None]
        for refinement in (0, 2):
            learned.refinement = refinement
            solution = learned.solve(np.array([point]), home)
            assert np.isfinite(solution.joints).all()
            assert np.isfinite(solution.error).all()
            assert (solution.joints >= learned.arm.joint_lower).all()
            assert (solution.joints <= learned.arm.joint_upper).all()


def test_limits_are_kept_whatever_the_model_says() -> None:
    wild = Wild("mico", "ik")
    for refinement in (0, 2):
        learned = LearnedInverseKinematics("mico", wild, refinement)
        joints = learned.solve(np.array([[0.4, 0.0, 0.2]])).joints
        assert (joints >= learned.arm.joint_lower).all()
        assert (joints <= learned.arm.joint_upper).all()


def test_endless_joints_turn_the_shorter_way() -> None:
    learned = LearnedInverseKinematics("mico")
    target = np.array([[0.4, 0.1, 0.2]])
    home = np.asarray(learned.arm.robot.home)[None].copy()
    here = learned.solve(target, home).joints
    home[0, 0] += 4 * np.pi
    assert learned.solve(target, home).joints[0, 0] == pytest.approx(here[0, 0] + 4 * np.pi)


def test_a_solver_without_a_model() -> None:
    arm = arm_named("jaco")
    samples = workspace_samples("jaco", 50, 5)
    assert reach(arm, samples.targets, None, arm.chain).reachable.all()
    near = nearest(arm, samples.targets, samples.joints + 0.1, arm.tool_chain)
    assert near.reachable.all()


@pytest.mark.parametrize("env_id", ["MicoPush-v0", "JacoPush-v0"])
def test_behind_the_seam_it_does_what_least_squares_does(env_id: str) -> None:
    robot = env_id[:4].lower()
    learned = LearnedInverseKinematics(robot)
    hands = []
    for inverse in (learned, None):
        episodes = make_episodes(env_id, 4, inverse_kinematics=inverse)
        for index in range(4):
            episodes.set_generator(index, np.random.default_rng(index))
        episodes.reset()
        for _ in range(12):
            episodes.step(np.tile([0.3, 0.5, 0.0], (4, 1)))
        hands.append(episodes.simulation.arm_state().tool_position)
    assert np.abs(hands[0] - hands[1]).max() < 0.02
    assert learned.unreachable.shape == (4, 1)


def test_vector_and_single_in_another_process_agree() -> None:
    learned = LearnedInverseKinematics("jaco")

    def single() -> gymnasium.Env[Any, Any]:

        return gymnasium.make("JacoPush-v0", inverse_kinematics=learned)

    vector = gymnasium.make_vec("JacoPush-v0", num_envs=3, inverse_kinematics=learned)
    alone = gymnasium.vector.AsyncVectorEnv([single], context="spawn")
    vector.reset(seed=5)
    alone.reset(seed=5)
    for _ in range(5):
        action = np.array([[0.5, -0.5, 0.0]], np.float32)
        together = vector.step(np.tile(action, (3, 1)))[0]
        apart = alone.step(action)[0]
    alone.close()
    assert np.abs(together["observation"][0] - apart["observation"][0]).max() < 1e-3


@pytest.mark.parametrize("env_id", ["MicoPush-v0", "JacoPush-v0", "DualMicoPickAndPlace-v0"])
def test_the_wrapper_turns_cartesian_actions_into_joint_actions(env_id: str) -> None:
    env = LearnedIKAction(gymnasium.make(env_id, control="joints"))
    wanted = gymnasium.make(env_id)
    assert env.action_space == wanted.action_space
    env.reset(seed=1)
    wanted.reset(seed=1)
    action = np.zeros(env.action_space.shape, np.float32)
    action[1] = 0.4
    before = env.unwrapped.episodes.simulation.arm_state().tool_position.copy()  # type: ignore[attr-defined]
    for _ in range(10):
        _, _, _, _, info = env.step(action)
        wanted.step(action)
    arms = env.unwrapped.episodes.task.n_arms  # type: ignore[attr-defined]
    assert info["ik_unreachable"].shape == (arms,)
    assert not info["ik_unreachable"].any()
    assert (info["ik_error"] < 1e-3).all()
    moved = env.unwrapped.episodes.simulation.arm_state().tool_position  # type: ignore[attr-defined]
    other = wanted.unwrapped.episodes.simulation.arm_state().tool_position  # type: ignore[attr-defined]
    assert moved[0, 0, 1] - before[0, 0, 1] > 0.05
    assert np.abs(moved - other).max() < 0.03


def test_the_wrapper_flags_what_is_out_of_reach(monkeypatch: pytest.MonkeyPatch) -> None:
    env = LearnedIKAction(gymnasium.make("MicoPush-v0", control="joints"))
    env.reset(seed=0)
    far = np.array([[[1.5, 0.0, 0.2]]])
    episodes = env.unwrapped.episodes  # type: ignore[attr-defined]
    monkeypatch.setattr(episodes, "moved_set_point", lambda _: far)
    observation, _, _, _, info = env.step(np.zeros(3, np.float32))
    assert info["ik_unreachable"].tolist() == [True]
    assert info["ik_error"][0] > 0.5
    assert np.isfinite(observation["observation"]).all()


def test_the_wrapper_refuses() -> None:
    with pytest.raises(ValueError, match="control='joints'"):
        LearnedIKAction(gymnasium.make("MicoPush-v0"))
    with pytest.raises(TypeError, match="environment of saver_envs"):
        LearnedIKAction(gymnasium.make("CartPole-v1"))
    env = gymnasium.make("MicoPush-v0", control="joints")
    with pytest.raises(ValueError, match="'jaco', task 'ik': 'mico' needs"):
        LearnedIKAction(env, shipped_model("jaco"))
    learned = LearnedIKAction(env)
    learned.reset(seed=0)
    for action, message in (
        (np.zeros(4), "must have shape"),
        (np.array([0, np.nan, 0]), "must be finite"),
    ):
        with pytest.raises(ValueError, match=message):
            learned.step(action)


def fitted(robot: str, task: str) -> InverseModel:
    model = new_model(
        "mlp",
        robot,
        task,  # type: ignore[arg-type]
        architecture=MLPArchitecture(1, 8),
    )
    values = np.random.default_rng(0).normal(size=(40, model.input_size + model.output_size))
    model.fit(values[:, : model.input_size], values[:, model.input_size :], Training(epochs=1))
    return model


def test_models_of_another_arm_or_task_are_refused() -> None:
    with pytest.raises(ValueError, match="robot 'mico', task 'id'"):
        LearnedInverseKinematics("mico", fitted("mico", "id"))
    with pytest.raises(ValueError, match="robot 'mico', task 'id'"):
        LearnedInverseDynamics("fetch", fitted("mico", "id"))
    with pytest.raises(ValueError, match="refinement=-1"):
        LearnedInverseKinematics("mico", refinement=-1)
    with pytest.raises(ValueError, match="kinematics are shipped for fetch, jaco, mico"):
        shipped_model("panda")
    with pytest.raises(ValueError, match="dynamics are shipped for fetch, mico"):
        shipped_model("jaco", "id")
    with pytest.raises(ValueError, match="robot='ur5'"):
        workspace_samples("ur5", 10, 0)


def test_wrong_targets_are_named() -> None:
    learned = LearnedInverseKinematics("mico")
    with pytest.raises(ValueError, match=r"targets of shape \(1, 6\)"):
        learned.solve(np.zeros((1, 6)))
    with pytest.raises(ValueError, match="must be finite"):
        learned.solve(np.array([[0.4, np.inf, 0.2]]))


def test_feed_forward_keeps_the_torque_limits() -> None:
    model = fitted("mico", "id")
    dynamics = LearnedInverseDynamics("mico", model)
    torque = dynamics(*np.full((3, 5, 4), 1e6))
    assert (np.abs(torque) <= np.asarray(model.arm.robot.joint_torque_limits)).all()


@pytest.mark.parametrize("robot", ["mico", "fetch"])
def test_shipped_dynamics_track_better_than_the_makers_figures(robot: str) -> None:
    interval = campaign_of(robot).interval
    ways = [random_trajectory(robot, 4, interval, np.random.default_rng(2000))]
    analytic = LearnedInverseDynamics(robot, new_model("analytic", robot, "id"))
    errors = {
        name: tracking_error(Twin(robot), ways, feed_forward, 2000).rms
        for name, feed_forward in (
            ("feedback", None),
            ("analytic", analytic),
            ("shipped", LearnedInverseDynamics(robot)),
        )
    }
    assert errors["shipped"] < 0.8 * errors["analytic"] < 0.8 * errors["feedback"]


def test_least_squares_is_still_the_default() -> None:
    episodes = make_episodes("MicoPush-v0")
    assert isinstance(episodes.inverse_kinematics, DampedLeastSquares)


@pytest.mark.parametrize("module", ["saver_envs", "saver_envs.modelling.newton_euler"])
def test_the_analytic_half_needs_no_torch(module: str) -> None:
    code = f"import sys, {module}; print('torch' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=True
    )
    assert done.stdout.strip() == "False"
