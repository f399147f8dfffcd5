"""Gymnasium-Robotics' interface: goals can be relabelled, and rewards agree with those of steps."""

import gymnasium
import numpy as np

env = gymnasium.make("saver_envs:JacoPickAndPlace-v0")
env.reset(seed=0)
for _ in range(20):
    observation, reward, *_, info = env.step(env.action_space.sample())
    achieved, desired = observation["achieved_goal"], observation["desired_goal"]
    assert reward == env.unwrapped.compute_reward(achieved, desired, info)
    assert env.unwrapped.compute_reward(achieved, achieved, info) == 0.0
    assert not env.unwrapped.compute_terminated(achieved, desired, info)
batch = np.tile(achieved, (4, 1)), np.tile(desired, (4, 1))
print("batch", env.unwrapped.compute_reward(*batch, {}))
print("time", env.unwrapped.data.time, "bodies", env.unwrapped.model.nbody)
