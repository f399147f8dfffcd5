"""TorchRL: a rollout, and one update of DDPG's loss on it."""

import torch
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.envs import CatTensors, RewardSum, TransformedEnv
from torchrl.envs.libs.gym import GymEnv
from torchrl.modules import ValueOperator
from torchrl.objectives import DDPGLoss

env = TransformedEnv(GymEnv("saver_envs:JacoPushDense-v0"), RewardSum())
keys = ["observation", "achieved_goal", "desired_goal"]
env.append_transform(CatTensors(keys, "features", del_keys=False))
rollout = env.rollout(60, break_when_any_done=False)

size, actions = rollout["features"].shape[-1], env.action_spec.shape[-1]
actor = TensorDictModule(
    nn.Sequential(nn.Linear(size, 64), nn.ReLU(), nn.Linear(64, actions), nn.Tanh()),
    in_keys=["features"],
    out_keys=["action"],
)


class Critic(nn.Module):
    """Q(features, action)."""

    def __init__(self):
        super().__init__()
        self.layers = nn.Sequential(nn.Linear(size + actions, 64), nn.ReLU(), nn.Linear(64, 1))

    def forward(self, features, action):
        return self.layers(torch.cat([features, action], dim=-1))


loss = DDPGLoss(actor, ValueOperator(Critic(), in_keys=["features", "action"]))
losses = loss(rollout)
(losses["loss_actor"] + losses["loss_value"]).backward()
print("steps", len(rollout), "value loss", losses["loss_value"].item())
