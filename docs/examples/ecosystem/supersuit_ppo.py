"""SuperSuit: two arms as agents of one shared policy, with normalized and stacked observations."""

import pettingzoo
import supersuit
from stable_baselines3 import PPO

import saver_envs  # noqa: F401  (registers the ids)

env = pettingzoo.make("parallel", "saver_envs/DualJacoPushDense-v0", bounded_observations=True)
env = supersuit.frame_stack_v2(supersuit.normalize_obs_v0(env), 2)
vector = supersuit.pettingzoo_env_to_vec_env_v1(env)
vector = supersuit.concat_vec_envs_v1(vector, 2, num_cpus=0, base_class="stable_baselines3")
model = PPO("MlpPolicy", vector, n_steps=50, batch_size=100)
model.learn(400)
observation = vector.reset()
print("observations", observation.shape, "in", observation.min(), "to", observation.max())
