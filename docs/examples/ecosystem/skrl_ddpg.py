"""skrl: DDPG on four environments that step together."""

import gymnasium
import torch
from skrl.agents.torch.ddpg import DDPG, DDPG_CFG
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, Model
from skrl.trainers.torch import SequentialTrainer
from torch import nn

env = wrap_env(gymnasium.make_vec("saver_envs:JacoPushDense-v0", num_envs=4))


class Network(DeterministicMixin, Model):
    """Actor, or critic with ``inputs`` that include the action."""

    def __init__(self, inputs, outputs, critic):
        Model.__init__(
            self,
            observation_space=env.observation_space,
            action_space=env.action_space,
            device=env.device,
        )
        DeterministicMixin.__init__(self)
        final = nn.Identity() if critic else nn.Tanh()
        self.critic = critic
        self.layers = nn.Sequential(nn.Linear(inputs, 64), nn.ReLU(), nn.Linear(64, outputs), final)

    def compute(self, inputs, role):
        seen = inputs["observations"]
        if self.critic:
            seen = torch.cat([seen, inputs["taken_actions"]], dim=-1)
        return self.layers(seen), {}


size, actions = env.reset()[0].shape[-1], env.action_space.shape[-1]
models = {
    name: Network(
        size + actions * ("critic" in name), 1 if "critic" in name else actions, "critic" in name
    )
    for name in ("policy", "target_policy", "critic", "target_critic")
}
agent = DDPG(
    models=models,
    memory=RandomMemory(memory_size=1_000, num_envs=env.num_envs, device=env.device),
    cfg=DDPG_CFG(learning_starts=50, batch_size=64),
    observation_space=env.observation_space,
    action_space=env.action_space,
    device=env.device,
)
SequentialTrainer(cfg={"timesteps": 120, "headless": True}, env=env, agents=agent).train()
