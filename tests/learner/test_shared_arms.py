"""One network for every arm: its symmetries, its replay, its files."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th
from gymnasium import spaces

from saver_advisors.learner import GoalDDPG, GoalTD3
from saver_advisors.learner.arms import ArmBlocks
from saver_advisors.learner.shared_arms import ArmNetwork, SharedArmsPolicy
from saver_advisors.policies.files import load_policy, load_teacher, save_policy
from saver_advisors.policies.freezing import networks_from_sb3
from saver_advisors.policies.frozen import PretrainedPolicy
from saver_advisors.policies.teacher import Teacher
from saver_envs.envs.sb3_vec_env import SaverVecEnv

CARD = {
    **{"env_id": "DualJacoPush-v0", "algorithm": "td3", "command": "-", "commit": ""},
    **{"steps": 0, "wall_clock_s": 0.0, "seed": 0, "success": 0.0},
}
OBSERVATION, GOAL, ACTION = 5, 3, 2


def blocks(n_arms: int, shared_goal: int = 0) -> ArmBlocks:
    bases = tuple((0.0, 0.72 * (arm - (n_arms - 1) / 2), 0.0) for arm in range(n_arms))
    return ArmBlocks(n_arms, OBSERVATION, GOAL, shared_goal, bases)


def make_policy(arms: ArmBlocks, seed: int = 0, **arguments: Any) -> SharedArmsPolicy:
    th.manual_seed(seed)
    n = arms.n_arms
    goal = spaces.Box(-5, 5, (n * GOAL + arms.shared_goal,), np.float32)
    observation = spaces.Box(-5, 5, (n * OBSERVATION,), np.float32)
    space = spaces.Dict(observation=observation, achieved_goal=goal, desired_goal=goal)
    box = spaces.Box(-1, 1, (n * ACTION,), np.float32)
    arguments = {"net_arch": [16, 16], "arms": arms.to_mapping(), **arguments}
    return SharedArmsPolicy(space, box, lambda _: 1e-3, **arguments)


def batch_of(arms: ArmBlocks, size: int = 6, seed: int = 1) -> dict[str, th.Tensor]:
    draw = th.Generator().manual_seed(seed)
    goal = arms.n_arms * GOAL + arms.shared_goal
    sizes = {"observation": arms.n_arms * OBSERVATION, "achieved_goal": goal, "desired_goal": goal}
    return {key: th.randn(size, width, generator=draw) for key, width in sizes.items()}


def permuted(values: th.Tensor, order: list[int], n_arms: int) -> th.Tensor:
    """The blocks of the arms in another order; what follows them stays."""
    size = len(values[0]) // n_arms * n_arms
    own = values[:, :size].unflatten(1, (n_arms, -1))[:, order].flatten(1)
    return th.cat((own, values[:, size:]), dim=1)


@pytest.mark.parametrize("n_arms", [2, 3, 4])
def test_arms_in_another_order_act_alike(n_arms: int) -> None:
    order = list(range(n_arms))[::-1]
    arms = blocks(n_arms)
    other = ArmBlocks(**{**vars(arms), "bases": tuple(arms.bases[arm] for arm in order)})
    policy, again = make_policy(arms), make_policy(other)
    again.load_state_dict(policy.state_dict())
    batch = batch_of(arms)
    turned = {key: permuted(value, order, n_arms) for key, value in batch.items()}
    actions = policy.actor(batch)
    th.testing.assert_close(permuted(actions, order, n_arms), again.actor(turned))
    values = policy.critic(batch, actions)[0]
    th.testing.assert_close(
        permuted(values, order, n_arms), again.critic(turned, permuted(actions, order, n_arms))[0]
    )


def test_neighbours_in_another_order_change_nothing() -> None:
    network = ArmNetwork(4, 4, 2, [8, 8], th.nn.ReLU, True, blocks(3))
    own = th.randn(5, 3, 4)
    before = network(own, own)[:, 0]
    network.poses[0] = network.poses[0].flip(0)
    swapped = own[:, [0, 2, 1]]
    th.testing.assert_close(before, network(swapped, swapped)[:, 0])
    assert not th.allclose(before, network(swapped, own)[:, 0])


def test_a_side_is_told_from_the_other() -> None:
    """Two arms that see the same act differently: one has its neighbour left, one right."""
    policy = make_policy(blocks(2))
    half = {key: value[:, : len(value[0]) // 2] for key, value in batch_of(blocks(2)).items()}
    actions = policy.actor({key: value.repeat(1, 2) for key, value in half.items()})
    assert not th.allclose(actions[:, :ACTION], actions[:, ACTION:])


@pytest.mark.parametrize("n_arms", [1, 2, 3, 4])
def test_without_neighbours_each_arm_is_the_single_arm(n_arms: int) -> None:
    """The same weights are those of any number of arms; with `pool` at 0 they ignore the others."""
    single, policy = make_policy(blocks(1), layer_norm=True), make_policy(blocks(n_arms), seed=1)
    policy.load_state_dict(single.state_dict())
    for module in policy.modules():
        if isinstance(module, ArmNetwork):
            module.pool.weight.data.zero_()
    batch = batch_of(blocks(n_arms))
    actions = policy.actor(batch)
    values = policy.critic(batch, actions)
    for arm in range(n_arms):
        own = {key: value.unflatten(1, (n_arms, -1))[:, arm] for key, value in batch.items()}
        action = single.actor(own)
        th.testing.assert_close(actions.unflatten(1, (n_arms, -1))[:, arm], action)
        for of_all, alone in zip(values, single.critic(own, action), strict=True):
            th.testing.assert_close(of_all[:, arm], alone[:, 0])


def test_bases_in_a_ring_are_seen_in_the_arms_own_frame() -> None:
    quarter = math.pi / 2
    arms = ArmBlocks(2, OBSERVATION, GOAL, 0, ((0.0, 0.0, 0.0), (0.6, -0.6, quarter)))
    first, second = arms.poses()[:, 0]
    th.testing.assert_close(first, th.tensor([0.6, -0.6, 0.0, 1.0]))
    th.testing.assert_close(second, th.tensor([0.6, 0.6, 0.0, -1.0]))


def test_what_all_arms_share_reaches_each(n_arms: int = 2) -> None:
    arms = blocks(n_arms, shared_goal=1)
    policy = make_policy(arms, n_costs=1)
    batch = batch_of(arms)
    assert policy.critic.reward_columns == (0, 1, 2, 2, 3, 3)
    assert policy.critic(batch, policy.actor(batch))[0].shape == (6, 6)
    before = policy.actor(batch)
    batch["desired_goal"][:, -1] += 1
    assert ((policy.actor(batch) - before).abs() > 1e-6).all()
    assert arms.columns(("observation", "desired_goal"))[1] == [*range(5, 10), 13, 14, 15, 16]


def test_the_normaliser_sees_the_arms_as_samples_of_one() -> None:
    features = make_policy(blocks(2)).shared_features
    batch = {key: value.numpy() for key, value in batch_of(blocks(2), size=50).items()}
    features.update(batch)
    both = np.concatenate(np.split(batch["observation"], 2, axis=1))
    np.testing.assert_allclose(features.shift[:OBSERVATION], both.mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(features.scale[:OBSERVATION], 1 / both.std(axis=0), rtol=1e-5)


def test_spaces_of_other_arms_are_refused() -> None:
    policy = make_policy(blocks(2))
    with pytest.raises(ValueError, match="'observation' has 10 numbers"):
        SharedArmsPolicy(
            policy.observation_space,
            policy.action_space,
            lambda _: 1e-3,
            arms=blocks(3).to_mapping(),
        )
    with pytest.raises(ValueError, match="n_arms=0"):
        ArmBlocks(0, 1, 1, 0, ())
    with pytest.raises(ValueError, match="x, y, yaw of 2 bases"):
        ArmBlocks(2, 1, 1, 0, ((0.0, 0.0, 0.0),))


# ------------------------------------------------------------------------------ with environments


def make_model(env_id: str = "DualJacoPush-v0", n_envs: int = 2, **arguments: Any) -> GoalTD3:
    options = arguments.pop("options", {})
    env = SaverVecEnv(env_id, n_envs=n_envs, seed=0, max_episode_steps=10, **options)
    settings: dict[str, Any] = {
        "train_freq": (10, "step"),
        "gradient_steps": 2,
        "learning_starts": 0,
        "batch_size": 32,
        "buffer_size": 2_000,
        "policy_kwargs": {"net_arch": [16, 16]},
        "seed": 0,
        "device": "cpu",
    }
    return GoalTD3("SharedArmsPolicy", env, **{**settings, **arguments})


@pytest.mark.parametrize("n_arms", [1, 2, 3, 4])
def test_it_learns_for_any_number_of_arms(n_arms: int) -> None:
    model = make_model(options={"n_arms": n_arms})
    before = {name: value.clone() for name, value in model.actor.named_parameters()}
    model.learn(60)
    changed = {
        name for name, value in model.actor.named_parameters() if not th.equal(value, before[name])
    }
    of_neighbours = {"mu.pair.weight", "mu.pair.bias", "mu.pool.weight"}
    assert changed == set(before) - (of_neighbours if n_arms == 1 else set())


def test_each_arm_is_relabelled_and_rewarded_on_its_own() -> None:
    model = make_model(replay_buffer_kwargs={"relabel_probability": 0.5})
    model.learn(200)
    drawn = model.replay_buffer.sample_transitions(500)
    relabelled = drawn.goal_step >= 0
    assert 0.15 < (relabelled[:, 0] & ~relabelled[:, 1]).mean() < 0.35
    env = SaverVecEnv("JacoPush-v0")  # one arm's reward
    for arm in (0, 1):
        own = slice(3 * arm, 3 * arm + 3)
        alone = env.compute_reward(
            drawn.next_achieved_goal[:, own], drawn.desired_goal[:, own], None
        )
        np.testing.assert_array_equal(drawn.reward[:, arm], alone)
        kept = ~relabelled[:, arm]
        np.testing.assert_array_equal(drawn.desired_goal[kept, own], drawn.episode_goal[kept, own])
    assert set(np.unique(drawn.reward)) == {-1.0, 0.0}
    # The others see the goal that the arm had when it acted.
    sampled = model.replay_buffer.as_samples(drawn)
    np.testing.assert_array_equal(sampled.observations["episode_goal"], drawn.episode_goal)


def test_the_team_shares_one_reward() -> None:
    model = make_model(replay_buffer_kwargs={"team_rewards": True})
    model.learn(200)
    drawn = model.replay_buffer.sample_transitions(500)
    assert set(np.unique(drawn.reward)) == {-1.0, -0.5, 0.0}
    assert (drawn.reward[:, 0] == drawn.reward[:, 1]).all()
    # Then an arm's value depends on the goals of the others, as they were relabelled.
    assert "episode_goal" not in model.replay_buffer.as_samples(drawn).observations


def test_an_arm_sees_its_own_relabelled_goal_and_the_others_true_one() -> None:
    policy = make_policy(blocks(2))
    batch = batch_of(blocks(2))
    batch["episode_goal"] = batch_of(blocks(2), seed=2)["desired_goal"]
    own, seen = policy.shared_features(batch)
    np.testing.assert_array_equal(own[:, 1, OBSERVATION:], batch["desired_goal"][:, GOAL:])
    np.testing.assert_array_equal(seen[:, 1, OBSERVATION:], batch["episode_goal"][:, GOAL:])
    np.testing.assert_array_equal(own[..., :OBSERVATION], seen[..., :OBSERVATION])


def test_arms_explore_independently() -> None:
    model = make_model(n_envs=4, random_action_probability=0.5, random_action_steps=4)
    model.learn(40)
    assert np.shape(model.held_actions.state_dict()["left"]) == (4, 2)


def test_sb3_saves_and_loads_it(tmp_path: Path) -> None:
    model = make_model(contact_cost=0.5, cost_limit=0.1)
    model.learn(60)
    model.save(tmp_path / "model")
    loaded = GoalTD3.load(tmp_path / "model", env=model.env)
    observation = model.env.reset()
    for one in (loaded, GoalTD3.load(tmp_path / "model")):
        np.testing.assert_array_equal(one.predict(observation)[0], model.predict(observation)[0])
        assert float(one.multiplier) == float(model.multiplier) != 0.5
    loaded.learn(20)


def test_learners_of_one_value_are_refused() -> None:
    with pytest.raises(TypeError, match="GoalDDPG learns one value"):
        GoalDDPG(SharedArmsPolicy, SaverVecEnv("DualJacoPush-v0"))


def test_another_environment_is_refused(make_env: Any) -> None:
    with pytest.raises(ValueError, match="need an environment of saver_envs"):
        GoalTD3("SharedArmsPolicy", make_env(2))


# ----------------------------------------------------------------------------------- frozen copies


@pytest.mark.parametrize("n_arms", [1, 2, 3, 4])
def test_a_frozen_copy_acts_alike(n_arms: int, tmp_path: Path) -> None:
    model = make_model(options={"n_arms": n_arms}, contact_cost=0.5)
    model.learn(60)
    observation = model.env.reset()
    expected = model.predict(observation, deterministic=True)[0]
    model.save(tmp_path / "model.zip")
    save_policy(tmp_path / "own.safetensors", networks_from_sb3(model), CARD)
    policy = load_policy(tmp_path / "own.safetensors")
    for networks in (policy.networks, load_teacher(tmp_path / "model.zip").networks):
        frozen = PretrainedPolicy(networks, policy.card, "own")
        np.testing.assert_allclose(frozen.predict(observation)[0], expected, atol=1e-5)


def test_a_single_arm_keeps_its_critics() -> None:
    """They become a teacher's: of the goal alone, without the value of costs."""
    model = make_model("JacoPush-v0", contact_cost=0.5)
    model.learn(60)
    teacher = Teacher.from_sb3(model)
    observation = model.env.reset()
    action = model.env.action_space.sample()[None].repeat(2, axis=0)
    own = teacher.q_value(observation["observation"], observation["desired_goal"], action)
    np.testing.assert_allclose(own, model.student_value(observation, action), rtol=1e-4)


def test_a_description_of_too_many_arms_is_refused(tmp_path: Path) -> None:
    model = make_model()
    model.policy_kwargs["arms"]["n_arms"] = 10**9
    model.save(tmp_path / "model.zip")
    with pytest.raises(ValueError, match="n_arms=1000000000: must be 1 to"):
        load_teacher(tmp_path / "model.zip")
