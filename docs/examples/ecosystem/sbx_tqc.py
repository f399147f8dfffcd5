"""SBX: TQC in JAX with Stable-Baselines3's hindsight replay."""

import sbx
from stable_baselines3 import HerReplayBuffer

from saver_envs.envs.sb3_vec_env import SaverVecEnv

env = SaverVecEnv("JacoPush-v0", n_envs=4, seed=0)
model = sbx.TQC(
    "MultiInputPolicy",
    env,
    replay_buffer_class=HerReplayBuffer,
    learning_starts=400,
    train_freq=16,
    gradient_steps=16,
    seed=0,
)
model.learn(1_000)
print("updates", model._n_updates)
