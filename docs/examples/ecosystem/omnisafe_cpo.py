"""OmniSafe: CPO on the distance task, registered as an environment of its own."""

from typing import ClassVar

import gymnasium
import omnisafe
import torch
from omnisafe.envs.core import CMDP, env_register


@env_register
class SaverDistance(CMDP):
    """Two arms that carry two cubes a shoulder's width apart."""

    _support_envs: ClassVar = ["DualJacoDistanceDense-v0"]
    need_auto_reset_wrapper = True
    need_time_limit_wrapper = False

    def __init__(self, env_id, **arguments):
        super().__init__(env_id)
        env = gymnasium.make(f"saver_envs:{env_id}")
        self.env = gymnasium.wrappers.FlattenObservation(env)
        self._observation_space, self._action_space = (
            self.env.observation_space,
            self.env.action_space,
        )

    def reset(self, seed=None, options=None):
        observation, info = self.env.reset(seed=seed)
        return torch.as_tensor(observation), info

    def step(self, action):
        observation, reward, terminated, truncated, info = self.env.step(action.numpy())
        values = (observation, reward, info["cost"], terminated, truncated)
        return *(torch.as_tensor(one, dtype=torch.float32) for one in values), info

    def set_seed(self, seed):
        self.env.reset(seed=seed)

    def render(self):
        return self.env.render()

    def close(self):
        self.env.close()


settings = {
    "train_cfgs": {"total_steps": 1_000},
    "algo_cfgs": {"steps_per_epoch": 500},
    "logger_cfgs": {"use_wandb": False, "use_tensorboard": False},
}
omnisafe.Agent("CPO", "DualJacoDistanceDense-v0", custom_cfgs=settings).learn()
