import numpy as np
import pytest
import torch
from sb3_contrib import TQC
from stable_baselines3 import DDPG, PPO, SAC, TD3
from stable_baselines3.common.vec_env import VecNormalize
from toy_arms import ACTION, GOAL, OBSERVATION, make_teacher, make_vec_env

from saver_advisors.learner import GoalDDPG, GoalSAC, GoalTD3, GoalTQC
from saver_advisors.policies.teacher import Teacher, TeacherGroup

STOCK = [DDPG, TD3, SAC, TQC]
OURS = [GoalDDPG, GoalTD3, GoalSAC, GoalTQC]


def trained(algorithm, vec_env=None, **arguments):
    model = algorithm(
        "MultiInputPolicy",
        vec_env or make_vec_env(2, n_arms=1),
        learning_starts=20,
        buffer_size=1000,
        batch_size=16,
        policy_kwargs={"net_arch": [16, 12], **arguments},
        seed=0,
    )
    return model.learn(60)


def sb3_values(model, observation, action):
    """(n, critics) by SB3's own networks."""
    tensors, _ = model.policy.obs_to_tensor(observation)
    scaled = torch.as_tensor(model.policy.scale_action(action)).float()
    with torch.no_grad():
        values = model.critic(tensors, scaled)
    if isinstance(values, tuple):
        return torch.cat(values, 1).numpy()
    return values.mean(2).numpy()


def random_inputs(n=7):
    rng = np.random.default_rng(3)
    observation = {
        "observation": rng.normal(size=(n, OBSERVATION)).astype(np.float32),
        "achieved_goal": rng.normal(size=(n, GOAL + 1)).astype(np.float32),
        "desired_goal": rng.normal(size=(n, GOAL + 1)).astype(np.float32),
    }
    return observation, rng.uniform([-2, -0.5], [4, 0.5], (n, ACTION)).astype(np.float32)


@pytest.mark.parametrize("algorithm", STOCK + OURS)
def test_a_frozen_model_acts_and_values_as_the_model_does(algorithm):
    model = trained(algorithm)
    teacher = Teacher.from_sb3(model)
    assert ("achieved_goal" in teacher.networks.spec.sizes) == (algorithm in STOCK)
    observation, action = random_inputs()
    parts = observation["observation"], observation["desired_goal"]
    achieved = observation["achieved_goal"]
    expected, _ = model.predict(observation, deterministic=True)
    np.testing.assert_allclose(teacher.act(*parts, achieved), expected, rtol=1e-4, atol=1e-5)
    values = sb3_values(model, observation, action)
    for twin, column in ((True, values.min(axis=1)), (False, values[:, 0])):
        got = teacher.q_value(*parts, action, achieved, twin_minimum=twin)
        np.testing.assert_allclose(got, column, rtol=1e-4, atol=1e-4)


def test_vec_normalize_is_folded_in():
    vec_env = VecNormalize(make_vec_env(2, n_arms=1), norm_obs_keys=["observation"], clip_obs=1.5)
    model = trained(TD3, vec_env)
    observation, _ = random_inputs()
    observation["observation"] *= 3
    expected, _ = model.predict(vec_env.normalize_obs(observation), deterministic=True)
    raw, _ = model.predict(observation, deterministic=True)
    got = Teacher.from_sb3(model).act(
        observation["observation"], observation["desired_goal"], observation["achieved_goal"]
    )
    np.testing.assert_allclose(got, expected, rtol=1e-4, atol=1e-5)
    assert not np.allclose(raw, expected, atol=1e-3), "the case must need the normaliser"


def test_training_on_does_not_change_the_teacher():
    model = trained(TD3)
    teacher = Teacher.from_sb3(model)
    observation, _ = random_inputs()
    inputs = [observation[key] for key in ("observation", "desired_goal", "achieved_goal")]
    before = teacher.act(*inputs)
    model.learn(60)
    np.testing.assert_array_equal(teacher.act(*inputs), before)
    assert not any(parameter.requires_grad for parameter in teacher.networks.parameters())


def test_what_cannot_be_frozen_is_refused():
    with pytest.raises(TypeError, match=r"PPO .*DDPG, TD3, SAC or TQC"):
        Teacher.from_sb3(PPO("MultiInputPolicy", make_vec_env(1), n_steps=8, batch_size=8))
    with pytest.raises(TypeError, match="gSDE"):
        Teacher.from_sb3(SAC("MultiInputPolicy", make_vec_env(1), use_sde=True, buffer_size=100))
    with pytest.raises(TypeError, match="Softplus"):
        Teacher.from_sb3(trained(TD3, activation_fn=torch.nn.Softplus))


def test_a_group_acts_as_its_members_one_by_one():
    left, right = make_teacher(1), make_teacher(2)
    group = TeacherGroup([left, right, left], 3)
    rng = np.random.default_rng(0)
    states = rng.normal(size=(5, 3, OBSERVATION)).astype(np.float32)
    goals = rng.normal(size=(5, 3, GOAL)).astype(np.float32)
    candidates = rng.uniform(-0.5, 0.5, (2, 5, 3, ACTION)).astype(np.float32)
    actions, values = group.act(states, goals), group.q_value(states, goals, candidates)
    for arm, teacher in enumerate((left, right, left)):
        expected = teacher.act(states[:, arm], goals[:, arm])
        np.testing.assert_allclose(actions[:, arm], expected, rtol=1e-5, atol=1e-6)
        for k in range(2):
            one = teacher.q_value(states[:, arm], goals[:, arm], candidates[k, :, arm])
            np.testing.assert_allclose(values[k, :, arm], one, rtol=1e-5, atol=1e-5)


def test_one_forward_pass_for_all_arms_and_environments(monkeypatch):
    teacher, batches = make_teacher(), []
    act = teacher._policy.action
    monkeypatch.setattr(
        teacher._policy, "action", lambda features: batches.append(len(features)) or act(features)
    )
    group = TeacherGroup(teacher, 2)
    group.act(np.zeros((16, 2, OBSERVATION)), np.zeros((16, 2, GOAL)))
    assert batches == [32]


def test_wrong_shapes_are_named():
    teacher = make_teacher()
    with pytest.raises(ValueError, match=r"observation has shape \(2, 5\).*\(n, 4\)"):
        teacher.act(np.zeros((2, 5)), np.zeros((2, GOAL)))
    with pytest.raises(ValueError, match="action has shape"):
        teacher.q_value(np.zeros((2, OBSERVATION)), np.zeros((2, GOAL)), np.zeros((3, ACTION)))
    reader = make_teacher(inputs=(("achieved_goal", GOAL), ("observation", OBSERVATION)))
    with pytest.raises(ValueError, match="'achieved_goal'"):
        reader.act(np.zeros((2, OBSERVATION)), np.zeros((2, GOAL)))
