"""A fresh student that acts as its teachers do, side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th
from toy_arms import ACTION, GOAL, OBSERVATION, make_teacher, make_vec_env
from toy_runs import BLOCK, assert_resumes_exactly, save_teacher, settings, start

from saver_advisors.advising.warm_start import warm_start_from_teachers
from saver_advisors.learner import GoalSAC, GoalTD3, GoalTQC
from saver_advisors.policies.mapping import ArmMapping
from saver_advisors.policies.networks import NetworkSpec, PolicyNetworks
from saver_advisors.policies.teacher import Teacher, TeacherGroup
from saver_advisors.pretrained import load_teacher, side_by_side
from saver_advisors.training.building import build_model
from saver_advisors.training.settings import RunConfig
from saver_envs.envs.sb3_vec_env import SaverVecEnv


def teacher_with_normaliser(seed: int = 0, **arguments: Any) -> Teacher:
    """Of the toy arm, with statistics that matter."""
    networks = make_teacher(seed, **arguments).networks
    generator = th.Generator().manual_seed(seed)
    networks.mean.copy_(th.randn(networks.mean.shape, generator=generator))
    networks.std.copy_(0.5 + th.rand(networks.std.shape, generator=generator))
    networks.clip.fill_(5.0)
    return Teacher(networks, f"toy-{seed}")


def without_layer_norm(seed: int = 0) -> Teacher:
    with th.random.fork_rng():
        th.manual_seed(seed)
        inputs = (("observation", OBSERVATION), ("desired_goal", GOAL))
        networks = PolicyNetworks(NetworkSpec(inputs, ACTION, (16, 16), (16, 16), 2))
    like = make_teacher(seed).networks
    for name in ("action_low", "action_high"):
        getattr(networks, name).copy_(getattr(like, name))
    networks.clip.fill_(5.0)
    return Teacher(networks, f"plain-{seed}")


def student(
    algorithm: Any = GoalTD3, n_arms: int = 2, net_arch: tuple[int, ...] = (32, 32), **policy: Any
) -> Any:
    parts = (GOAL,) * n_arms + (1,)
    apart = policy.get("n_values", 1) > 1
    return algorithm(
        "MultiInputPolicy",
        make_vec_env(2, n_arms=n_arms),
        buffer_size=2000,
        learning_starts=0,
        train_freq=10,
        gradient_steps=4,
        batch_size=32,
        policy_kwargs={"net_arch": list(net_arch), **policy},
        replay_buffer_kwargs={"horizon": 10, "goal_parts": parts if apart else None},
        seed=0,
        device="cpu",
    )


def begin(model: Any, teachers: Any, n_arms: int = 2) -> tuple[str, TeacherGroup, ArmMapping]:
    group = TeacherGroup(teachers, n_arms)
    mapping = ArmMapping(n_arms, OBSERVATION, GOAL, ACTION)
    return warm_start_from_teachers(model, group, mapping), group, mapping


def rows(n_arms: int = 2, n: int = 50, scale: float = 3.0) -> dict[str, Any]:
    """Observations some of which the normaliser clips."""
    rng = np.random.default_rng(0)
    goal = n_arms * GOAL + 1
    sizes = {"observation": n_arms * OBSERVATION, "achieved_goal": goal, "desired_goal": goal}
    return {k: rng.normal(0, scale, (n, size)).astype(np.float32) for k, size in sizes.items()}


@pytest.mark.parametrize("apart", [False, True])
def test_the_shipped_teacher_on_two_real_arms(apart: bool) -> None:
    advice = {"strategy": "none", "teacher": "jaco-push", "budget": 0, "warm_start": True}
    values = {"env_id": "DualJacoPush-v0", "n_envs": 8, "per_arm_critics": apart, "advice": advice}
    env = SaverVecEnv("DualJacoPush-v0", n_envs=8, seed=0)
    model = build_model(RunConfig.from_mapping(values), env)
    pair = side_by_side(load_teacher("jaco-push"), 2)
    now: Any = env.reset()
    for _ in range(15):
        expected, _ = pair.predict(now)
        np.testing.assert_allclose(model.predict(now, deterministic=True)[0], expected, atol=1e-5)
        now, *_ = env.step(expected)


@pytest.mark.parametrize("net_arch", [(32, 32), (40, 48)])
@pytest.mark.parametrize("algorithm", [GoalTD3, GoalSAC, GoalTQC])
def test_any_student_acts_as_different_teachers_do(
    algorithm: Any, net_arch: tuple[int, ...]
) -> None:
    pair = [teacher_with_normaliser(1), teacher_with_normaliser(2)]
    model = student(algorithm, net_arch=net_arch)
    expected, _ = side_by_side(pair, 2).predict(rows())
    before = model.predict(rows(), deterministic=True)[0]
    assert np.abs(before - expected).max() > 0.5
    begin(model, pair)
    np.testing.assert_allclose(
        model.predict(rows(), deterministic=True)[0], expected, rtol=1e-5, atol=1e-5
    )


def test_a_student_keeps_the_normaliser_of_its_teachers() -> None:
    """Without its teachers' statistics, it would not act as they do: their networks fit these."""
    model = student()
    begin(model, teacher_with_normaliser(4))
    features = model.actor.features_extractor
    of_arms = features.count > 0
    shift, scale = features.shift.clone(), features.scale.clone()
    before = model.predict(rows(), deterministic=True)[0]
    features.update({name: 5 + 2 * values for name, values in rows(n=1000).items()})
    th.testing.assert_close(features.shift[of_arms], shift[of_arms], rtol=1e-4, atol=1e-4)
    th.testing.assert_close(features.scale[of_arms], scale[of_arms], rtol=1e-4, atol=1e-4)
    assert not of_arms.all() and (features.scale[~of_arms] != scale[~of_arms]).all()
    np.testing.assert_allclose(model.predict(rows(), deterministic=True)[0], before, atol=1e-3)


@pytest.mark.parametrize("n_arms", [1, 3])
def test_one_teacher_for_any_number_of_arms(n_arms: int) -> None:
    teacher = teacher_with_normaliser(4)
    model = student(n_arms=n_arms, net_arch=(16 * n_arms, 16 * n_arms))
    begin(model, teacher, n_arms)
    expected, _ = side_by_side(teacher, n_arms).predict(rows(n_arms))
    actual = model.predict(rows(n_arms), deterministic=True)[0]
    np.testing.assert_allclose(actual, expected, rtol=1e-5, atol=1e-5)


def values(model: Any, group: TeacherGroup, mapping: ArmMapping) -> tuple[Any, Any]:
    """The student's value of each arm and the teachers' own, by critic: (critics, n, arms)."""
    seen = rows(scale=1.0)
    rng = np.random.default_rng(1)
    scaled = rng.uniform(-1, 1, (50, 2 * ACTION)).astype(np.float32)
    executed = mapping.split_action(model.policy.unscale_action(scaled))
    tensors, _ = model.policy.obs_to_tensor(seen)
    with th.no_grad():
        own = th.stack(model.critic(tensors, th.as_tensor(scaled)))[:, :, :2].numpy()
    observations = mapping.split_observation(seen["observation"])
    goals = mapping.split_goal(seen["desired_goal"])
    first, least = (
        group.q_value(observations, goals, executed[None], twin_minimum=twin)[0]
        for twin in (False, True)
    )
    return own, np.stack((first, least))


def test_critics_of_each_arm_are_exact_without_layer_norm() -> None:
    model = student(n_values=3, layer_norm=False, net_arch=(36, 32))
    kind, group, mapping = begin(model, [without_layer_norm(1), without_layer_norm(2)])
    assert kind == "exact"
    own, (first, least) = values(model, group, mapping)
    np.testing.assert_allclose(own[0], first, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(own.min(axis=0), least, rtol=1e-4, atol=1e-5)
    for name, tensor in model.critic.state_dict().items():
        assert tensor.equal(model.critic_target.state_dict()[name])
    for name, tensor in model.actor.state_dict().items():
        assert tensor.equal(model.actor_target.state_dict()[name])


@pytest.mark.parametrize("layer_norm", [False, True])
def test_critics_that_differ_in_layer_norm_start_fresh(layer_norm: bool) -> None:
    teacher = without_layer_norm() if layer_norm else teacher_with_normaliser()
    model = student(n_values=3, layer_norm=layer_norm, net_arch=(36, 32))
    assert begin(model, teacher)[0] == "fresh"


def test_critics_with_layer_norm_start_near() -> None:
    """The shipped teacher's critics, in the states of a scene of two arms."""
    env = SaverVecEnv("DualJacoPush-v0", n_envs=32, seed=0)
    seen: Any = env.reset()
    teacher = load_teacher("jaco-push")
    mapping, group = ArmMapping(2, 28, 3, 3), TeacherGroup(teacher, 2)
    config = {"env_id": "DualJacoPush-v0", "per_arm_critics": True, "n_envs": 32}
    model: Any = build_model(RunConfig.from_mapping(config), env)
    assert warm_start_from_teachers(model, group, mapping) == "approximate"
    actions = np.random.default_rng(0).uniform(-1, 1, (32, 6)).astype(np.float32)
    tensors, _ = model.policy.obs_to_tensor(seen)
    with th.no_grad():
        own = model.critic(tensors, th.as_tensor(actions))[0].numpy()
    expected = group.q_value(
        mapping.split_observation(seen["observation"]),
        mapping.split_goal(seen["desired_goal"]),
        mapping.split_action(actions)[None],
        twin_minimum=False,
    )[0]
    assert np.corrcoef(own.ravel(), expected.ravel())[0, 1] > 0.9
    assert np.abs(own - expected).max() > 1e-3, "it would be exact: say so in the docs"


@pytest.mark.parametrize(
    ("algorithm", "policy"),
    [(GoalTD3, {}), (GoalSAC, {}), (GoalTQC, {}), (GoalTD3, {"n_values": 3, "layer_norm": False})],
)
def test_critics_that_cannot_be_a_teachers_start_afresh(algorithm: Any, policy: Any) -> None:
    """One value of all arms, quantiles, or LayerNorm in the teacher's critics alone."""
    model, untouched = student(algorithm, **policy), student(algorithm, **policy)
    assert begin(model, teacher_with_normaliser())[0] == "fresh"
    for name, tensor in untouched.critic.state_dict().items():
        if "features" not in name:
            assert tensor.equal(model.critic.state_dict()[name]), name


def test_learning_goes_on_from_there() -> None:
    """Zeros between the arms' blocks are learned over, and the normaliser hardly moves."""
    teacher = teacher_with_normaliser()
    model = student()
    begin(model, teacher)
    features = model.actor.features_extractor
    shift, known = features.shift.clone(), features.count > 0
    assert not bool(known.all()), "the goal's last entry is no arm's"
    model.learn(60)
    moved = (features.shift - shift).abs()
    assert 0 < float(moved[known].max()) < 0.01
    assert float(moved[~known].max()) > 0.01, "what no teacher knows is learned at once"
    first, second, _ = (layer for layer in model.actor.mu if isinstance(layer, th.nn.Linear))
    assert float(first.weight.detach()[:16, OBSERVATION : 2 * OBSERVATION].abs().max()) > 0
    assert float(second.weight.detach()[:16, 16:].abs().max()) > 0


@pytest.mark.parametrize("net_arch", [(32,), (32, 32, 32), (31, 32), (32, 16)])
def test_students_that_cannot_hold_the_teachers_are_refused(net_arch: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"net_arch=.* cannot hold .*use net_arch=\[32, 32\]"):
        begin(student(net_arch=net_arch), teacher_with_normaliser())


def test_teachers_of_another_make_are_refused() -> None:
    with pytest.raises(ValueError, match=r"clips its input at \[inf\], the student at 5.0"):
        begin(student(), make_teacher())
    wide = teacher_with_normaliser()
    wide.networks.action_high.fill_(9.0)
    with pytest.raises(ValueError, match=r"actions with high \[9.0, 9.0\]"):
        begin(student(), wide)
    stock = (("achieved_goal", GOAL), ("desired_goal", GOAL), ("observation", OBSERVATION))
    with pytest.raises(ValueError, match="reads the achieved goal"):
        begin(student(), teacher_with_normaliser(inputs=stock))


def test_a_run_that_starts_as_its_teachers_resumes(tmp_path: Path) -> None:
    advice = {
        "strategy": "none",
        "teacher": save_teacher(tmp_path),
        "budget": 0,
        "warm_start": True,
    }
    assert_resumes_exactly(settings(advice), tmp_path)


def test_a_run_that_cannot_is_refused_before_a_step(tmp_path: Path) -> None:
    advice = {
        "strategy": "early",
        "teacher": save_teacher(tmp_path),
        "budget": BLOCK,
        "warm_start": True,
    }
    with pytest.raises(ValueError, match=r"net_arch=\[16\] cannot hold"):
        start(settings(advice, net_arch=[16]), tmp_path / "run")


@pytest.mark.parametrize("n_arms", [1, 2, 4])
def test_shared_arms_start_as_one_teacher(n_arms: int) -> None:
    """Actor and critics are exactly the teacher's for each arm, until the neighbours are seen."""
    teacher = load_teacher("jaco-push")
    env = SaverVecEnv("DualJacoPush-v0", n_envs=3, seed=0, n_arms=n_arms)
    model = GoalTD3(
        "SharedArmsPolicy",
        env,
        policy_kwargs={"net_arch": [128, 128, 128]},
        contact_cost=0.5,
        seed=0,
    )
    mapping = ArmMapping(n_arms, 28, 3, 3)
    group = TeacherGroup(teacher, n_arms)
    assert warm_start_from_teachers(model, group, mapping) == "exact"
    observation = env.reset()
    blocks = mapping.split_observation(observation["observation"])
    goals = mapping.split_goal(observation["desired_goal"])
    action, _ = model.predict(observation, deterministic=True)
    np.testing.assert_allclose(mapping.split_action(action), group.act(blocks, goals), atol=1e-5)
    own = group.q_value(blocks, goals, mapping.split_action(action)[None])[0].mean(axis=1)
    np.testing.assert_allclose(model.student_value(observation, action), own, rtol=1e-4)


def test_shared_arms_refuse_what_is_not_one_teacher() -> None:
    env = SaverVecEnv("DualJacoPush-v0", n_envs=1, seed=0)
    model = GoalTD3("SharedArmsPolicy", env, policy_kwargs={"net_arch": [64, 64, 64]}, seed=0)
    mapping, teacher = ArmMapping(2, 28, 3, 3), load_teacher("jaco-push")
    with pytest.raises(ValueError, match=r"net_arch=\[128, 128, 128\], or wider"):
        warm_start_from_teachers(model, TeacherGroup(teacher, 2), mapping)
    two = TeacherGroup([teacher, load_teacher("jaco-push")], 2)
    with pytest.raises(ValueError, match="start from one teacher for all arms"):
        warm_start_from_teachers(model, two, mapping)
