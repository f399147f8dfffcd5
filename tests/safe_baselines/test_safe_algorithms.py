"""The three algorithms on SB3's API: what they learn from, refuse, save and go on with."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th
from sb3_contrib import TRPO
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import VecNormalize
from toy_costs import LENGTH, CostOfAngle, make_walk

from saver_advisors.safe_baselines import (
    ALGORITHMS,
    CPO,
    CostConstrainedMixin,
    LagrangianMixin,
    PPOLagrangian,
    TRPOLagrangian,
)
from saver_envs.envs.sb3_vec_env import SaverVecEnv

CLASSES = list(ALGORITHMS.values())
N_ENVS, N_STEPS = 3, 20
each = pytest.mark.parametrize("algorithm", CLASSES, ids=ALGORITHMS)


def naive_advantages(signal, values, last_values, starts, dones, gamma, lam):
    """The definition: discounted sums of one-step differences, up to the end of the episode."""
    steps, n_envs = signal.shape
    advantages = np.zeros((steps, n_envs))
    for env in range(n_envs):
        ends = [bool(starts[t + 1, env]) for t in range(steps - 1)] + [bool(dones[env])]
        following = [*values[1:, env], last_values[env]]
        for begin in range(steps):
            weight = 1.0
            for t in range(begin, steps):
                beyond = 0.0 if ends[t] else gamma * following[t]
                advantages[begin, env] += weight * (signal[t, env] + beyond - values[t, env])
                weight *= gamma * lam
                if ends[t]:
                    break
    return advantages


def make_model(algorithm: type[CostConstrainedMixin], env: Any, **arguments: Any) -> Any:
    goal = hasattr(env.observation_space, "spaces")
    settings = {
        "n_steps": N_STEPS,
        "batch_size": 30,
        "policy_kwargs": {"net_arch": [16]},
        "n_cost_critic_updates": 3,
        "seed": 0,
        "device": "cpu",
        **arguments,
    }
    model = algorithm("MultiInputPolicy" if goal else "MlpPolicy", env, **settings)
    model.set_logger(Logger(folder=None, output_formats=[]))
    return model


def weights(model: Any) -> dict[str, th.Tensor]:
    """Copies of what policy and cost critic hold."""
    return {
        f"{name}.{key}": value.clone()
        for name in ("policy", "cost_critic")
        for key, value in model.get_parameters()[name].items()
    }


class Recorder(BaseCallback):
    """Keeps what the environments said, step by step."""

    def __init__(self, stop_at: int | None = None) -> None:
        super().__init__()
        self.costs: list[list[float]] = []
        self.dones: list[Any] = []
        self.infos: list[Any] = []
        self.stop_at = stop_at

    def _on_step(self) -> bool:
        self.costs.append([info["cost"] for info in self.locals["infos"]])
        self.dones.append(np.array(self.locals["dones"]))
        self.infos.append(self.locals["infos"])
        return self.n_calls != self.stop_at


def episode_sums(recorder: Recorder, last_steps: int) -> list[float]:
    """Sums of cost of the episodes that ended in the last steps, environment by environment."""
    costs, dones = np.array(recorder.costs), np.array(recorder.dones)
    sums = []
    for env in range(costs.shape[1]):
        ends = np.flatnonzero(dones[:, env])
        for begin, end in zip([0, *(ends[:-1] + 1)], ends, strict=True):
            if end >= len(costs) - last_steps:
                sums.append(costs[begin : end + 1, env].sum())
    return sums


@each
@pytest.mark.parametrize("goal", [False, True], ids=["box", "goal"])
def test_learns_saves_and_predicts(algorithm, goal, tmp_path):
    env = make_walk(N_ENVS, goal=goal)
    model = make_model(algorithm, env)
    before = weights(model)
    recorder = Recorder()
    model.learn(2 * N_STEPS * N_ENVS, callback=recorder)
    assert model.num_timesteps == 2 * N_STEPS * N_ENVS
    # J_c is of the episodes that ended in the last rollout, some of which began in the one before.
    assert model.mean_episode_cost == pytest.approx(np.mean(episode_sums(recorder, N_STEPS)))
    assert model.mean_episode_length == LENGTH
    after = weights(model)
    for name in ("policy.mlp_extractor.policy_net", "policy.value_net", "cost_critic"):
        keys = [key for key in before if key.startswith(name)]
        assert any(not th.equal(after[key], before[key]) for key in keys), name
    model.save(tmp_path / "model")
    loaded = algorithm.load(tmp_path / "model", device="cpu")
    observation = env.reset()
    np.testing.assert_array_equal(
        loaded.predict(observation, deterministic=True)[0],
        model.predict(observation, deterministic=True)[0],
    )
    np.testing.assert_array_equal(loaded._cost_values(observation), model._cost_values(observation))


@each
def test_costs_of_the_rollout_are_those_of_the_environments(algorithm):
    """With the value of the last state added where a time limit cut an episode off."""
    model = make_model(algorithm, make_walk(N_ENVS, goal=True), cost_gamma=0.9)
    critic = model.cost_critic
    rollouts = []

    class Keep(Recorder):
        def _on_rollout_end(self) -> None:
            rollouts.append(model._cost_rollout.rewards.copy())

    recorder = Keep()
    model.learn(N_STEPS * N_ENVS, callback=recorder)
    fresh = make_model(algorithm, make_walk(N_ENVS, goal=True))
    assert critic is model.cost_critic
    expected = np.array(recorder.costs, np.float32)
    for step, (dones, infos) in enumerate(zip(recorder.dones, recorder.infos, strict=True)):
        for env in np.flatnonzero(dones):
            assert infos[env]["TimeLimit.truncated"]
            last = {key: one[None] for key, one in infos[env]["terminal_observation"].items()}
            # The same seed gives the critic that was in force during the first rollout.
            expected[step, env] += 0.9 * fresh._cost_values(last)[0]
    assert np.array(recorder.dones).sum() >= 2 * N_ENVS
    np.testing.assert_allclose(rollouts[0], expected, atol=1e-6)


def test_a_real_end_is_no_time_limit():
    model = make_model(CPO, make_walk(N_ENVS, ends=True))
    recorder = Recorder()
    model.learn(N_STEPS * N_ENVS, callback=recorder)
    np.testing.assert_allclose(model._cost_rollout.rewards, recorder.costs, atol=1e-6)


def test_advantages_of_costs_end_with_the_value_of_the_last_state():
    model = make_model(TRPOLagrangian, make_walk(N_ENVS, ends=True))
    kept = {}

    class Keep(BaseCallback):
        def _on_step(self) -> bool:
            return True

    train = type(model).train

    def look(self: Any) -> None:
        rollout = self._cost_rollout
        kept["expected"] = naive_advantages(
            rollout.rewards,
            rollout.values,
            self._cost_values(self._last_obs),
            self.rollout_buffer.episode_starts,
            self._last_episode_starts,
            self.cost_gamma,
            self.cost_gae_lambda,
        )
        kept["found"] = rollout.advantages
        train(self)

    model.train = look.__get__(model)
    model.learn(N_STEPS * N_ENVS, callback=Keep())
    np.testing.assert_allclose(kept["found"], kept["expected"], atol=1e-4)


@each
def test_the_batched_environments_of_saver(algorithm):
    env = SaverVecEnv("DualJacoDistance-v0", 2, seed=0, max_episode_steps=10)
    model = make_model(algorithm, env)
    recorder = Recorder()
    model.learn(N_STEPS * 2, callback=recorder)
    assert model.mean_episode_cost == pytest.approx(np.mean(episode_sums(recorder, N_STEPS)))
    assert recorder.dones[9].all()
    env.close()


@each
@pytest.mark.parametrize("limit", [-0.1, float("nan"), float("inf"), None, "low", True])
def test_a_limit_that_is_none_is_refused(algorithm, limit):
    with pytest.raises(ValueError, match="cost_limit="):
        make_model(algorithm, make_walk(1), cost_limit=limit)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("cost_gamma", 0.0),
        ("cost_gamma", 1.5),
        ("cost_gae_lambda", -0.1),
        ("n_cost_critic_updates", 0),
    ],
)
def test_bad_settings_are_named(name, value):
    with pytest.raises(ValueError, match=f"{name}={value}"):
        make_model(CPO, make_walk(1), **{name: value})


@each
@pytest.mark.parametrize(("bad", "words"), [("absent", "info\\['cost'\\]"), (np.nan, "finite")])
def test_bad_costs_are_refused_at_the_first_step(algorithm, bad, words):
    model = make_model(algorithm, make_walk(2, bad=bad))
    before = weights(model)
    with pytest.raises(ValueError, match=words):
        model.learn(200)
    assert model.num_timesteps == 2
    assert all(th.equal(value, before[key]) for key, value in weights(model).items())


def test_a_cost_that_goes_bad_later_is_refused_too():
    model = make_model(CPO, make_walk(2, bad=np.nan, bad_from=5))
    with pytest.raises(ValueError, match="environment 0"):
        model.learn(200)


def test_another_entry_can_be_the_cost():
    env = SaverVecEnv("DualJacoDistance-v0", 1, seed=0, max_episode_steps=10)
    model = make_model(CPO, env, cost_key="cost_collision")
    model.learn(N_STEPS)
    assert model.mean_episode_cost == 0.0
    env.close()


@each
def test_resuming_goes_on_with_everything_learned(algorithm, tmp_path):
    """A loaded model and the one that was saved learn the same from the same rollout on."""
    model = make_model(algorithm, make_walk(N_ENVS), cost_limit=0.2)
    model.learn(3 * N_STEPS * N_ENVS)
    model.save(tmp_path / "model.zip")
    loaded = algorithm.load(tmp_path / "model.zip", env=make_walk(N_ENVS, seed=1), device="cpu")
    loaded.set_logger(Logger(folder=None, output_formats=[]))
    assert loaded.cost_limit == 0.2
    assert loaded.mean_episode_cost == model.mean_episode_cost
    if hasattr(model, "multiplier"):
        assert float(loaded.multiplier) == float(model.multiplier) > 0.1
        kept = [one.multiplier.optimizer.state_dict()["state"] for one in (model, loaded)]
        assert kept[0][0]["exp_avg"] == kept[1][0]["exp_avg"]
        assert kept[0][0]["step"] == kept[1][0]["step"] == 3
    steps = model.num_timesteps
    model.set_env(make_walk(N_ENVS, seed=1))
    for one in (model, loaded):
        one.set_random_seed(5)
        one.learn(N_STEPS * N_ENVS, reset_num_timesteps=False)
        assert one.num_timesteps == steps + N_STEPS * N_ENVS
    assert loaded.mean_episode_cost == model.mean_episode_cost
    expected = weights(model)
    for key, value in weights(loaded).items():
        np.testing.assert_array_equal(value, expected[key], err_msg=key)
    if hasattr(model, "multiplier"):
        assert float(model.multiplier) == float(loaded.multiplier)


@each
def test_set_parameters_takes_the_multiplier_along(algorithm):
    source, target = (make_model(algorithm, make_walk(N_ENVS), seed=seed) for seed in (0, 1))
    source.learn(N_STEPS * N_ENVS)
    target.set_parameters(source.get_parameters())
    observation = source.env.reset()
    np.testing.assert_array_equal(
        source._cost_values(observation), target._cost_values(observation)
    )
    if hasattr(source, "multiplier"):
        assert float(source.multiplier) == float(target.multiplier)


@each
def test_a_callback_can_stop_and_learning_goes_on(algorithm):
    model = make_model(algorithm, make_walk(N_ENVS))
    model.learn(1000, callback=Recorder(stop_at=N_STEPS + 5))
    assert model.num_timesteps == (N_STEPS + 5) * N_ENVS
    sums = []

    class Sums(Recorder):
        def _on_rollout_end(self) -> None:
            sums.append(1)

    model.learn(N_STEPS * N_ENVS, callback=Sums(), reset_num_timesteps=False)
    assert sums == [1]
    # Torn episodes are left out, so every one that counts is whole.
    assert model.mean_episode_length == LENGTH


def test_no_episode_in_a_rollout_is_said_and_leaves_the_policy():
    model = make_model(CPO, make_walk(N_ENVS), n_steps=LENGTH // 2)
    before = weights(model)
    with pytest.warns(UserWarning, match="no episode ended"):
        model.learn(LENGTH // 2 * N_ENVS)
    after = weights(model)
    actor = [key for key in before if key.startswith("policy") and "value" not in key]
    assert len(actor) >= 5
    assert all(th.equal(after[key], before[key]) for key in actor)
    assert model.mean_episode_cost is None


def test_normalised_observations_reach_the_critic_normalised():
    env = VecNormalize(make_walk(N_ENVS, goal=True))
    model = make_model(TRPOLagrangian, env)
    recorder = Recorder()
    model.learn(N_STEPS * N_ENVS, callback=recorder)
    # Rewards are scaled, costs are not: the limit is on what the environment says.
    assert model.mean_episode_cost == pytest.approx(np.mean(episode_sums(recorder, N_STEPS)))
    assert np.abs(env.get_original_reward()).max() <= 1.0


@pytest.mark.parametrize(("ours", "plain"), [(PPOLagrangian, PPO), (TRPOLagrangian, TRPO)])
def test_at_a_price_of_nothing_it_is_the_plain_algorithm(ours, plain):
    """With lambda 0 a Lagrangian learns what the algorithm below learns, bit for bit."""
    arguments = {
        "n_steps": N_STEPS,
        "batch_size": N_STEPS * N_ENVS,
        "policy_kwargs": {"net_arch": [16]},
        "seed": 0,
        "device": "cpu",
        "normalize_advantage": False,
    }
    models = []
    for build, more in (
        (ours, {"cost_limit": 1e6, "multiplier_init": 0.0}),
        (plain, {}),
    ):
        model = build("MlpPolicy", make_walk(N_ENVS), **arguments, **more)
        model.set_random_seed(3)
        model._last_obs = None
        models.append(model.learn(N_STEPS * N_ENVS))
    expected = models[1].get_parameters()["policy"]
    for key, value in models[0].get_parameters()["policy"].items():
        np.testing.assert_allclose(value, expected[key], atol=1e-6, err_msg=key)


@each
def test_the_cost_decides_what_is_learned(algorithm):
    """The reward of a walk is twice its cost: under a limit that it exceeds, effort goes down."""
    arguments = {"n_steps": 32, "batch_size": 128, "learning_rate": 0.01, "gamma": 1.0}
    if issubclass(algorithm, TRPO):
        arguments["target_kl"] = 0.05
    costs = []
    for limit, price in ((100.0, 0.0), (0.2, 10.0)):
        if issubclass(algorithm, LagrangianMixin):
            arguments["multiplier_init"] = price
        model = make_model(algorithm, make_walk(4, ends=True), cost_limit=limit, **arguments)
        model.learn(32 * 4 * 6)
        costs.append(model.mean_episode_cost)
    assert costs[0] > 2 * costs[1]


def test_dividing_by_the_length_is_an_option():
    values = []
    for divide in (True, False):
        model = make_model(CPO, make_walk(N_ENVS), divide_by_episode_length=divide)
        model.mean_episode_cost, model.mean_episode_length = 5.0, 8.0
        values.append(model._excess())
    assert values == [0.5, 4.0]


def test_sub_sampling_of_goal_observations():
    model = make_model(CPO, make_walk(N_ENVS, goal=True), sub_sampling_factor=2)
    model.learn(N_STEPS * N_ENVS)
    assert model._n_updates == 1


@each
def test_discrete_actions(algorithm):
    env = make_vec_env("CartPole-v1", n_envs=2, seed=0, wrapper_class=CostOfAngle)
    model = make_model(algorithm, env)
    model.learn(N_STEPS * 2 * 2)
    assert model._n_updates >= 2


@pytest.mark.slow
def test_the_snippet_of_the_page_runs(tmp_path, monkeypatch):
    page = Path(__file__).parents[2] / "docs" / "safe-baselines.md"
    code = re.findall(r"^```python\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE)[0]
    monkeypatch.chdir(tmp_path)
    exec(compile(code, page.name, "exec"), {})
    assert (tmp_path / "cpo.zip").is_file()
