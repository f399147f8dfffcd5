import json
import math
from dataclasses import replace

import gymnasium
import numpy as np
import pytest

from saver_advisors.evaluation.episodes import (
    EpisodeOutcomes,
    SingleEpisodeEnv,
    evaluate_policy,
    play,
    run_episodes,
)
from saver_envs.digest import world_digest
from saver_envs.tasks.distance import Distance

#: Reads the goals of two objects and a distance.
TASK = Distance(n_arms=2)


class FakeVecEnv:
    """Episodes whose every figure follows from their seed: length 2 + seed % 3, success at the end
    where the seed is even (odd ones succeed in the middle), costs 0.1 * seed at step 1."""

    def __init__(self, n_envs):
        self.num_envs, self.seeds_seen, self.seeds = n_envs, [], [None] * n_envs

    def reset_episodes(self, seeds):
        assert len(seeds) == self.num_envs
        self.seeds, self.clock = list(seeds), [0] * self.num_envs
        self.seeds_seen.append(list(seeds))
        return self._observe()

    def _observe(self):
        seeds = np.array([-1 if seed is None else seed for seed in self.seeds], float)
        return {
            "observation": np.stack([seeds, np.array(self.clock, float)], axis=1),
            "achieved_goal": np.zeros((self.num_envs, 7)),
            "desired_goal": np.zeros((self.num_envs, 7)),
        }

    def step(self, actions):
        rewards, dones, infos = [], [], []
        for k, seed in enumerate(self.seeds):
            self.clock[k] += 1
            # Episodes after the autoreset are of no interest: they carry absurd figures.
            done = seed is not None and self.clock[k] == 2 + seed % 3
            cost = 1e9 if seed is None else (0.1 * seed if self.clock[k] == 1 else 0.0)
            info = {
                "is_success": seed is not None and (seed % 2 == 0) == done,
                "goal_reached": bool(done),
                "diverged": seed == 4,
                "cost": cost,
                "cost_distance": float(cost > 0),
            }
            rewards.append(1e9 if seed is None else float(actions[k, 0]))
            dones.append(done)
            if done:
                goal = np.array([3.0 + seed, 4.0 * 0, 0, 0, 5.0, 0, 99.0])
                info["terminal_observation"] = {
                    "achieved_goal": goal,
                    "desired_goal": np.zeros(7),
                }
                self.seeds[k], self.clock[k] = None, 0
            infos.append(info)
        return self._observe(), np.array(rewards), np.array(dones), infos


def predict(observation):
    """The reward will be the seed, once a step."""
    return observation["observation"][:, :1]


@pytest.mark.parametrize("n_envs", [1, 3, 4, 16])
def test_episode_i_has_seed_plus_i_whatever_the_vector(n_envs):
    outcomes = run_episodes(predict, FakeVecEnv(n_envs), TASK, env_id="fake", episodes=10, seed=100)
    seeds = np.arange(100, 110)
    lengths = 2 + seeds % 3
    np.testing.assert_array_equal(outcomes.lengths, lengths)
    np.testing.assert_allclose(outcomes.returns, seeds * lengths)
    np.testing.assert_array_equal(outcomes.success, seeds % 2 == 0)
    np.testing.assert_allclose(outcomes.cost_sums["cost"], 0.1 * seeds)
    np.testing.assert_allclose(outcomes.cost_maxima["cost"], 0.1 * seeds)
    # Two objects in a goal of 7: the last entry is a distance, no object.
    expected = np.stack([3.0 + seeds, np.full(10, 5.0)], axis=1)
    np.testing.assert_allclose(outcomes.final_distances, expected)
    assert outcomes.goal_reached is not None
    assert outcomes.goal_reached.all()
    assert outcomes.episodes == 10


def test_the_first_seed_is_0_by_default():
    env = FakeVecEnv(2)
    assert run_episodes(predict, env, TASK, env_id="fake", episodes=2).seed == 0
    assert env.seeds_seen == [[0, 1]]


def test_one_env_as_a_vector_keeps_the_last_observation_of_an_episode():
    env = SingleEpisodeEnv(gymnasium.make("JacoPush-v0", max_episode_steps=2))
    first = env.reset_episodes([3])
    assert first["observation"].shape == (1, 28)
    ends = []
    for _ in range(2):
        seen, rewards, dones, [info] = env.step(np.zeros((1, 3)))
        ends.append("terminal_observation" in info)
        assert rewards.shape == dones.shape == (1,)
        assert dones.tolist() == [ends[-1]]
    assert ends == [False, True]
    np.testing.assert_array_equal(
        info["terminal_observation"]["observation"], seen["observation"][0]
    )


def test_seeds_are_asked_for_in_order():
    env = FakeVecEnv(4)
    run_episodes(predict, env, TASK, env_id="fake", episodes=6, seed=7)
    assert env.seeds_seen == [[7, 8, 9, 10], [11, 12, 13, 14]]


def test_summary_and_rates():
    outcomes = run_episodes(predict, FakeVecEnv(5), TASK, env_id="fake", episodes=5, seed=0)
    summary = json.loads(json.dumps(outcomes.summary()))
    assert summary["env"] == "fake"
    assert (summary["episodes"], summary["seed"]) == (5, 0)
    assert summary["success_rate"] == 0.6
    # Episode 0 alone costs nothing.
    assert summary["constraint_met_rate"] == 0.2
    assert summary["goal_success_rate"] == 1.0
    assert summary["diverged"] == 1
    assert summary["cost_means"]["cost"] == pytest.approx(0.2)
    # Wilson's formula, by hand.
    n, p, z = 5, 0.6, 1.959963984540054
    centre = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    assert summary["ci95"] == pytest.approx([centre - half, centre + half])


def test_safe_success_and_success_within_two_centimetres():
    outcomes = EpisodeOutcomes(
        env_id="fake",
        seed=0,
        success=np.array([True, True, True, False]),
        returns=np.zeros(4),
        cost_sums={"cost": np.ones(4), "cost_collision": np.array([0.0, 1.0, 0.0, 0.0])},
        cost_maxima={},
        final_distances=np.array([[0.02, 0.01], [0.01, 0.01], [0.021, 0.01], [0.0, 0.0]]),
        lengths=np.full(4, 50),
        diverged=np.zeros(4, bool),
    )
    assert (outcomes.safe_success_rate, outcomes.success_rate_2cm) == (0.5, 0.5)
    rates = outcomes.summary()
    assert (rates["safe_success_rate"], rates["success_rate_2cm"]) == (0.5, 0.5)
    assert rates["cost_rates"] == {"cost": 1.0, "cost_collision": 0.25}
    assert replace(outcomes, unit="rad").success_rate_2cm == 0.75  # within four degrees
    summed = {"cost": np.array([0.0, 1.0, 1.0, 0.0])}
    assert replace(outcomes, cost_sums=summed).safe_success_rate == 0.25
    assert replace(outcomes, cost_sums={}).safe_success_rate == 0.75


def test_forces_and_losses_are_those_of_the_environment():
    """An arm that goes into the table, and a cube that is thrown off it."""

    def down(observation):
        actions = np.zeros((len(observation["observation"]), 6))
        actions[:, 2] = -1
        return actions

    kwargs = {"control": "joints", "max_episode_steps": 20}
    outcomes = evaluate_policy(down, "JacoPush-v0", episodes=3, env_kwargs=kwargs)
    touched = outcomes.cost_sums["cost_collision"] > 0
    assert touched.any()
    np.testing.assert_array_equal(outcomes.collision_forces > 0, touched)
    summary = outcomes.summary()
    assert summary["collision_force_max"] == outcomes.collision_forces.max()
    assert summary["collision_force_mean"] == outcomes.collision_forces.mean()
    assert summary["object_lost"] == 0
    assert summary["world"] == world_digest("JacoPush-v0", kwargs)
    assert summary["world"] != world_digest("JacoPush-v0")
    lost = replace(outcomes, lost=np.array([True, False, True]))
    assert lost.summary()["object_lost"] == 2


def test_play_yields_the_reset_and_every_step_of_each_episode():
    env = FakeVecEnv(2)
    steps = [list(play(predict, env, seeds)) for seeds in ([0, 1], [2, 3])]
    # Seeds 0 and 1 last 2 and 3 steps; seeds 2 and 3 last 4 and 2.
    assert [[step.number for step in one] for one in steps] == [[0, 1, 2, 3], [0, 1, 2, 3, 4]]
    assert [step.running.tolist() for step in steps[0]] == [[True, True]] * 3 + [[False, True]]


def test_senseless_counts_are_refused():
    with pytest.raises(ValueError, match="episodes=0"):
        evaluate_policy(predict, "JacoPush-v0", episodes=0)


def test_real_episodes_are_reproducible_one_by_one():
    def drift(observation):
        return 0.3 * np.sign(observation["desired_goal"] - observation["achieved_goal"])

    few = {"env_kwargs": {"max_episode_steps": 8}}
    together = evaluate_policy(drift, "JacoPush-v0", episodes=4, seed=20, **few)
    alone = evaluate_policy(drift, "JacoPush-v0", episodes=1, seed=23, **few)
    first = evaluate_policy(drift, "JacoPush-v0", episodes=1, **few)
    zero = evaluate_policy(drift, "JacoPush-v0", episodes=1, seed=0, **few)
    np.testing.assert_array_equal(first.final_distances, zero.final_distances)
    assert together.lengths.tolist() == [8] * 4
    assert len(np.unique(together.final_distances)) == 4
    np.testing.assert_allclose(alone.final_distances[0], together.final_distances[3], atol=1e-6)
    assert together.summary()["env"] == "JacoPush-v0"
    assert together.constraint_met_rate is None


def test_deviation_from_the_required_value_is_of_the_episode_alone():
    """In the toy it is 0 until the last step, whose goal is 99 away."""
    outcomes = run_episodes(predict, FakeVecEnv(2), TASK, env_id="Fake", episodes=3, seed=0)
    lengths = np.array([2, 3, 4])
    np.testing.assert_allclose(outcomes.deviations[:, 0], 99.0 / lengths)
    np.testing.assert_allclose(outcomes.deviations[:, 1], 99.0)
    summary = outcomes.summary()
    assert summary["deviation_worst"] == 99.0
    assert math.isclose(summary["deviation_mean"], float((99.0 / lengths).mean()))


def test_a_task_without_a_constraint_has_no_deviation():
    still = evaluate_policy(
        lambda observation: np.zeros((len(observation["observation"]), 6)),
        "DualJacoPush-v0",
        episodes=2,
        env_kwargs={"max_episode_steps": 3},
    )
    assert still.deviations is None
    assert "deviation_mean" not in still.summary()
    kept = evaluate_policy(
        lambda observation: np.zeros((len(observation["observation"]), 8)),
        "DualJacoDistance-v0",
        episodes=2,
        env_kwargs={"max_episode_steps": 3},
    )
    assert 0 < kept.deviations[:, 1].max() <= 0.0151, "nobody has touched the cubes"
