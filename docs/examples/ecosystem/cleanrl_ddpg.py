"""CleanRL-style: DDPG in one file, on Gymnasium's vector API."""

import gymnasium
import numpy as np
import torch
from torch import nn

ENV_ID, STEPS, START, BATCH, GAMMA, TAU, NOISE = "JacoPushDense-v0", 400, 100, 64, 0.98, 0.005, 0.1

envs = gymnasium.make_vec(f"saver_envs:{ENV_ID}", num_envs=4)
envs = gymnasium.wrappers.vector.FlattenObservation(envs)
envs = gymnasium.wrappers.vector.RecordEpisodeStatistics(envs)
size, actions = envs.single_observation_space.shape[0], envs.single_action_space.shape[0]


def mlp(inputs, outputs, *last):
    return nn.Sequential(nn.Linear(inputs, 128), nn.ReLU(), nn.Linear(128, outputs), *last)


actor, target_actor = mlp(size, actions, nn.Tanh()), mlp(size, actions, nn.Tanh())
critic, target_critic = mlp(size + actions, 1), mlp(size + actions, 1)
target_actor.load_state_dict(actor.state_dict())
target_critic.load_state_dict(critic.state_dict())
actor_optimizer = torch.optim.Adam(actor.parameters(), 1e-3)
critic_optimizer = torch.optim.Adam(critic.parameters(), 1e-3)
memory, rng = [], np.random.default_rng(0)

observation, _ = envs.reset(seed=0)
returns = []
for step in range(STEPS):
    with torch.no_grad():
        action = actor(torch.as_tensor(observation)).numpy()
    action = np.clip(action + rng.normal(0, NOISE, action.shape), -1, 1).astype(np.float32)
    following, reward, terminated, truncated, info = envs.step(action)
    memory.append((observation, action, reward.astype(np.float32), following, terminated))
    observation = following
    if "episode" in info:
        returns += info["episode"]["r"][info["_episode"]].tolist()
    if step < START:
        continue
    rows = [memory[index] for index in rng.integers(0, len(memory), BATCH // envs.num_envs)]
    seen, taken, gained, then, ended = (
        torch.as_tensor(np.concatenate([row[column] for row in rows])) for column in range(5)
    )
    with torch.no_grad():
        value = target_critic(torch.cat([then, target_actor(then)], 1)).squeeze(1)
        goal = gained + GAMMA * ~ended * value
    critic_loss = (critic(torch.cat([seen, taken], 1)).squeeze(1) - goal).square().mean()
    critic_optimizer.zero_grad()
    critic_loss.backward()
    critic_optimizer.step()
    actor_loss = -critic(torch.cat([seen, actor(seen)], 1)).mean()
    actor_optimizer.zero_grad()
    actor_loss.backward()
    actor_optimizer.step()
    for network, target in ((actor, target_actor), (critic, target_critic)):
        for new, old in zip(network.parameters(), target.parameters(), strict=True):
            old.data.lerp_(new.data, TAU)
print("episodes", len(returns), "mean return", np.mean(returns))
