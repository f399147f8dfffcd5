"""RLlib: SAC on the dense twin, for two iterations."""

import gymnasium
import ray
from ray.rllib.algorithms.sac import SACConfig
from ray.tune.registry import register_env


def make(config):
    env = gymnasium.make("saver_envs:JacoPushDense-v0")
    return gymnasium.wrappers.FlattenObservation(env)


ray.init(num_cpus=1, include_dashboard=False)
register_env("saver", make)
config = (
    SACConfig()
    .environment("saver")
    .env_runners(num_env_runners=0, rollout_fragment_length=50)
    .training(num_steps_sampled_before_learning_starts=100, train_batch_size_per_learner=64)
    .reporting(min_sample_timesteps_per_iteration=200)
)
algorithm = config.build_algo()
for _ in range(2):
    result = algorithm.train()
print("mean return", result["env_runners"]["episode_return_mean"])
algorithm.stop()
