"""Stable-Baselines3 and sb3-contrib: the checker, then TQC with hindsight replay."""

import gymnasium
from sb3_contrib import TQC
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.env_checker import check_env

env = gymnasium.make("saver_envs:JacoPush-v0")
check_env(env.unwrapped)
model = TQC(
    "MultiInputPolicy", env, replay_buffer_class=HerReplayBuffer, learning_starts=100, seed=0
)
model.learn(200)
print("updates", model._n_updates)
