"""Safety-Gymnasium's interface: a step returns the cost as its third value."""

import gymnasium
from safety_gymnasium.utils.task_utils import get_task_class_name  # noqa: F401  (is it installed?)

from saver_envs.wrappers.cost_step import CostStep

env = CostStep(gymnasium.make("saver_envs:WristPush-v0"))
env.reset(seed=0)
observation, reward, cost, terminated, truncated, info = env.step(env.action_space.sample())
print("cost", cost)
