"""TD3 with hindsight goals in one file, to be read from top to bottom.

It knows Gymnasium's vector API and nothing of SAVER, and is put beside the shipped baselines by

    saver benchmark run --env JacoPush-v0 --algo docs/examples/td3_her.py:TD3HER \
        --steps 400000 --seed 0 --output runs/td3-her

or runs by itself: `python docs/examples/td3_her.py --env JacoPush-v0 --steps 400000`.

TD3: Fujimoto et al., arXiv 1802.09477. Hindsight goals: Andrychowicz et al., arXiv 1707.01495.
"""

import argparse
import copy
import time

import gymnasium
import numpy as np
import torch
from torch import nn


def mlp(inputs, outputs, hidden, layer_norm=False):
    layers = []
    for width in hidden:
        layers += [nn.Linear(inputs, width)]
        layers += [nn.LayerNorm(width)] if layer_norm else []
        layers += [nn.ReLU()]
        inputs = width
    return nn.Sequential(*layers, nn.Linear(inputs, outputs))


class Networks(nn.Module):
    """Actor, two critics, and the running mean and deviation of what they look at."""

    def __init__(self, inputs, actions, hidden):
        super().__init__()
        self.actor = nn.Sequential(mlp(inputs, actions, hidden), nn.Tanh())
        # LayerNorm keeps the critics from running away before the first success is seen.
        self.critics = nn.ModuleList(mlp(inputs + actions, 1, hidden, True) for _ in range(2))
        self.register_buffer("count", torch.tensor(1e-2, dtype=torch.float64))
        self.register_buffer("total", torch.zeros(inputs, dtype=torch.float64))
        self.register_buffer("squares", torch.zeros(inputs, dtype=torch.float64))

    def see(self, rows):
        self.count += len(rows)
        self.total += rows.double().sum(0)
        self.squares += rows.double().square().sum(0)

    def normalize(self, rows):
        mean = self.total / self.count
        deviation = (self.squares / self.count - mean**2).clamp_min(1e-4).sqrt()
        return ((rows - mean) / deviation).clamp(-5, 5).float()

    def values(self, inputs, actions):
        both = torch.cat([inputs, actions], 1)
        return [critic(both).squeeze(1) for critic in self.critics]


class Episodes:
    """Whole episodes in a ring; transitions are drawn with goals that were reached later."""

    def __init__(self, capacity, horizon, sizes, seed):
        observation, goal, action = sizes
        self.observation = np.zeros((capacity, horizon + 1, observation), np.float32)
        self.achieved = np.zeros((capacity, horizon + 1, goal), np.float32)
        self.desired = np.zeros((capacity, goal), np.float32)
        self.action = np.zeros((capacity, horizon, action), np.float32)
        self.length = np.zeros(capacity, np.int64)
        self.stored, self.random = 0, np.random.default_rng(seed)

    def add(self, observation, achieved, desired, action, length):
        rows = (self.stored + np.arange(len(length))) % len(self.length)
        self.observation[rows], self.achieved[rows] = observation, achieved
        self.desired[rows], self.action[rows], self.length[rows] = desired, action, length
        self.stored += len(length)

    def draw(self, n, relabel, reward):
        row = self.random.integers(0, min(self.stored, len(self.length)), n)
        step = (self.random.random(n) * self.length[row]).astype(int)
        later = step + 1 + (self.random.random(n) * (self.length[row] - step)).astype(int)
        hindsight = (self.random.random(n) < relabel)[:, None]
        goal = np.where(hindsight, self.achieved[row, later], self.desired[row])
        now = np.concatenate([self.observation[row, step], goal], 1)
        then = np.concatenate([self.observation[row, step + 1], goal], 1)
        rewards = np.asarray(reward(self.achieved[row, step + 1], goal, {}), np.float32)
        return map(torch.as_tensor, (now, self.action[row, step], rewards, then))


class TD3HER:
    """The learner: `learn(steps)` acts in its environment, `predict(observation)` is its policy."""

    def __init__(
        self,
        env,
        *,
        seed=0,
        hidden=(128, 128, 128),
        batch_size=256,
        updates=40,  # after each round of episodes, one in every environment
        learning_rate=1e-3,
        gamma=0.98,
        tau=0.01,
        noise=0.15,
        random_actions=0.2,
        action_penalty=0.1,
        relabel=0.8,
        capacity=6_000,  # episodes
    ):
        torch.manual_seed(seed)
        self.env, self.seed, self.random = env, seed, np.random.default_rng(seed)
        spaces, action = env.single_observation_space, env.single_action_space
        sizes = [spaces["observation"].shape[0], spaces["desired_goal"].shape[0], action.shape[0]]
        self.sizes, self.capacity, self.episodes = sizes, capacity, None
        self.networks = Networks(sizes[0] + sizes[1], sizes[2], hidden)
        self.targets = copy.deepcopy(self.networks)
        actor, critics = self.networks.actor, self.networks.critics
        self.actor_optimizer = torch.optim.Adam(actor.parameters(), learning_rate, fused=True)
        self.critic_optimizer = torch.optim.Adam(critics.parameters(), learning_rate, fused=True)
        self.batch_size, self.updates, self.gamma, self.tau = batch_size, updates, gamma, tau
        self.noise, self.random_actions = noise, random_actions
        self.action_penalty, self.relabel = action_penalty, relabel
        self.state_dict = self.networks.state_dict
        self.load_state_dict = self.networks.load_state_dict

    def predict(self, observation):
        rows = np.concatenate([observation["observation"], observation["desired_goal"]], 1)
        with torch.no_grad():
            return self.networks.actor(self.networks.normalize(torch.as_tensor(rows))).numpy()

    def explore(self, observation):
        action = self.predict(observation)
        action = action + self.noise * self.random.standard_normal(action.shape)
        anything = self.random.uniform(-1, 1, action.shape)
        replaced = self.random.random((len(action), 1)) < self.random_actions
        return np.where(replaced, anything, action).clip(-1, 1).astype(np.float32)

    def learn(self, steps):
        done = 0
        while done < steps:
            done += self.play_round()
            for update in range(self.updates):
                self.update(with_actor=update % 2 == 0)

    def play_round(self):
        """One episode in every environment; all of them start together."""
        observation, _ = self.env.reset(seed=self.seed if self.episodes is None else None)
        seen, actions, length = [observation], [], np.zeros(self.env.num_envs, np.int64)
        running = np.ones(self.env.num_envs, bool)
        while running.any():
            action = self.explore(observation)
            observation, _, terminated, truncated, _ = self.env.step(action)
            seen.append(observation)
            actions.append(action)
            length += running  # one that ended early is reset by the environment: not counted
            running &= ~(terminated | truncated)
        inputs, achieved = (
            np.stack([one[key] for one in seen], 1) for key in ("observation", "achieved_goal")
        )
        desired, actions = seen[0]["desired_goal"], np.stack(actions, 1)
        if self.episodes is None:
            self.episodes = Episodes(self.capacity, actions.shape[1], self.sizes, self.seed)
        self.episodes.add(inputs, achieved, desired, actions, length)
        # Both kinds of goals that the networks will meet: the episode's own, and reached ones.
        for goals in (np.repeat(desired[:, None], actions.shape[1], 1), achieved[:, 1:]):
            rows = np.concatenate([inputs[:, :-1], goals], 2)
            self.networks.see(torch.as_tensor(rows.reshape(-1, rows.shape[-1])))
        return int(length.sum())

    def update(self, with_actor):
        reward = self.env.unwrapped.compute_reward
        now, action, rewards, then = self.episodes.draw(self.batch_size, self.relabel, reward)
        now, then = self.networks.normalize(now), self.networks.normalize(then)
        with torch.no_grad():
            smooth = (0.1 * torch.randn_like(action)).clamp(-0.2, 0.2)
            following = (self.targets.actor(then) + smooth).clamp(-1, 1)
            future = torch.minimum(*self.targets.values(then, following))
            # No return of rewards of -1 and 0 lies outside these bounds.
            target = (rewards + self.gamma * future).clamp(-1 / (1 - self.gamma), 0)
        loss = sum((value - target).square().mean() for value in self.networks.values(now, action))
        self.critic_optimizer.zero_grad()
        loss.backward()
        self.critic_optimizer.step()
        if not with_actor:
            return
        action = self.networks.actor(now)
        value = self.networks.critics[0](torch.cat([now, action], 1)).mean()
        self.actor_optimizer.zero_grad()
        (self.action_penalty * action.square().mean() - value).backward()
        self.actor_optimizer.step()
        with torch.no_grad():
            pairs = zip(self.targets.parameters(), self.networks.parameters(), strict=True)
            for target, source in pairs:
                target.lerp_(source, self.tau)


def success_rate(learner, env, rounds=7, seed=10_000):
    successes = []
    for k in range(rounds):
        observation, _ = env.reset(seed=seed + k * env.num_envs)
        over = np.zeros(env.num_envs, bool)
        while not over.all():
            observation, _, terminated, truncated, info = env.step(learner.predict(observation))
            over |= terminated | truncated
        successes += info["is_success"].tolist()
    return np.mean(successes)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--env", default="JacoPush-v0")
    parser.add_argument("--steps", type=int, default=400_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--every", type=int, default=40_000, help="steps between evaluations")
    args = parser.parse_args()
    torch.set_num_threads(1)
    train_env, test_env = (
        gymnasium.make_vec(f"saver_envs:{args.env}", 16, vectorization_mode="vector_entry_point")
        for _ in range(2)
    )
    learner, done, start = TD3HER(train_env, seed=1_000_000 + args.seed), 0, time.perf_counter()
    while done < args.steps:
        learner.learn(args.every)
        done += args.every
        rate = success_rate(learner, test_env)
        print(
            f"{done:>9,} steps  success {rate:.2f}  {time.perf_counter() - start:.0f} s", flush=True
        )
