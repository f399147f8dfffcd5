"""Models of SB3 and of the learner room, frozen into weight files, act as before."""

import json

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from sb3_contrib import TQC
from stable_baselines3 import DDPG, SAC, TD3
from stable_baselines3.common.vec_env import DummyVecEnv

from saver_advisors.cli import main
from saver_advisors.learner import GoalDDPG, GoalSAC, GoalTD3, GoalTQC
from saver_advisors.policies.files import WEIGHTS_DIR, save_policy
from saver_advisors.policies.freezing import networks_from_sb3
from saver_advisors.pretrained import load_policy


class Reach(gymnasium.Env):
    """The smallest goal environment, with the sizes of one arm."""

    horizon = 10

    def __init__(self):
        box = spaces.Box(-5, 5, (3,), np.float32)
        self.observation_space = spaces.Dict(
            {
                "observation": spaces.Box(-5, 5, (28,), np.float32),
                "achieved_goal": box,
                "desired_goal": box,
            }
        )
        self.action_space = spaces.Box(np.float32([-2, -1, 0]), np.float32([1, 1, 3]))

    def _observe(self):
        return {key: space.sample() for key, space in self.observation_space.spaces.items()}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.clock = 0
        return self._observe(), {}

    def step(self, action):
        self.clock += 1
        return self._observe(), -1.0, False, self.clock >= self.horizon, {}

    def compute_reward(self, achieved, desired, info):
        return -np.ones(np.shape(achieved)[:-1], np.float32)


@pytest.mark.parametrize("algorithm", [DDPG, TD3, SAC, TQC, GoalDDPG, GoalTD3, GoalSAC, GoalTQC])
def test_an_exported_model_predicts_as_before(algorithm, card, tmp_path):
    model = algorithm(
        "MultiInputPolicy",
        DummyVecEnv([Reach]),
        learning_starts=20,
        buffer_size=500,
        batch_size=16,
        policy_kwargs={"net_arch": {"pi": [16, 12], "qf": [14]}},
        seed=0,
    ).learn(40)
    path = save_policy(tmp_path / "exported.safetensors", networks_from_sb3(model), card)
    policy = load_policy(path)
    observation = {
        key: np.stack([space.sample() for _ in range(5)])
        for key, space in model.observation_space.spaces.items()
    }
    expected, _ = model.predict(observation, deterministic=True)
    np.testing.assert_allclose(policy.predict(observation)[0], expected, rtol=1e-4, atol=1e-5)
    single = {key: values[2] for key, values in observation.items()}
    np.testing.assert_allclose(policy.predict(single)[0], expected[2], rtol=1e-4, atol=1e-5)
    spec = policy.networks.spec
    assert (spec.actor_hidden, spec.critic_hidden) == ((16, 12), (14,))
    stock = algorithm in (DDPG, TD3, SAC, TQC)
    assert spec.critic_layer_norm == (not stock)
    keys = ["achieved_goal", "desired_goal", "observation"]
    assert [key for key, _ in spec.inputs] == (keys if stock else ["observation", "desired_goal"])


def test_a_weight_file_is_measured_again(tmp_path, capsys):
    path, data = tmp_path / "again.safetensors", tmp_path / "again.json"
    words = ["export", str(WEIGHTS_DIR / "jaco-push.safetensors"), "--path", str(path)]
    assert main([*words, "--episodes", "4", "--json", str(data)]) == 0
    assert f"wrote {path}" in capsys.readouterr().out
    before, after = load_policy("jaco-push").card, load_policy(path).card
    summary = json.loads(data.read_text())["summary"]
    assert after.success_episodes == summary["episodes"] == 4
    rates = (after.success, after.safe_success, after.success_2cm)
    names = ("success_rate", "safe_success_rate", "success_rate_2cm")
    assert rates == tuple(summary[name] for name in names)
    assert after.success >= after.safe_success >= 0
    assert (after.command, after.steps, after.commit) == (
        before.command,
        before.steps,
        before.commit,
    )
    assert (
        f"| success within 2 cm | {after.success_2cm:.3f} |" in path.with_suffix(".md").read_text()
    )
    path.write_bytes(path.read_bytes()[:-1])
    assert main(["export", str(path), "--path", str(path)]) == 2
    assert "again.safetensors" in capsys.readouterr().err
