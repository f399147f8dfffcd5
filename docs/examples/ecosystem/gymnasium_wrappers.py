"""Gymnasium: the checker, and the wrappers that people put round an environment."""

import warnings

import gymnasium
from gymnasium import wrappers
from gymnasium.utils.env_checker import check_env

warnings.filterwarnings("ignore", message=".*infinity.*")
env = gymnasium.make("saver_envs:DualJacoPush-v0", render_mode="rgb_array")
check_env(env.unwrapped)
env = wrappers.TimeAwareObservation(env, flatten=False)
env = wrappers.RecordEpisodeStatistics(wrappers.ClipAction(env))
env.reset(seed=0)
truncated = False
while not truncated:
    *_, truncated, info = env.step(env.action_space.sample())
print("steps", info["episode"]["l"], "of", env.spec.max_episode_steps)
