"""A goal environment with two point-like arms and an asymmetric action box, and teachers for it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv

from saver_advisors.policies.networks import NetworkSpec, PolicyNetworks
from saver_advisors.policies.teacher import Teacher
from saver_envs.tasks.layout import Layout, Part

N_ARMS, OBSERVATION, GOAL, ACTION = 2, 4, 3, 2
ARM_LOW = np.array([-2.0, -0.5], np.float32)
ARM_HIGH = np.array([4.0, 0.5], np.float32)


class ToyArms(gymnasium.Env[dict[str, NDArray[Any]], NDArray[Any]]):
    """Each arm moves a point; the flat goal has one entry more than the arms' blocks."""

    def __init__(self, horizon: int = 10, n_arms: int = N_ARMS) -> None:
        goal = spaces.Box(-10, 10, (n_arms * GOAL + 1,), np.float32)
        self.observation_space = spaces.Dict(
            {
                "observation": spaces.Box(-10, 10, (n_arms * OBSERVATION,), np.float32),
                "achieved_goal": goal,
                "desired_goal": goal,
            }
        )
        self.action_space = spaces.Box(np.tile(ARM_LOW, n_arms), np.tile(ARM_HIGH, n_arms))
        self.n_arms, self.horizon = n_arms, horizon
        parts = (Part("place", GOAL, "m"), Part("distance", 1, "m", shared=True))
        self.episodes = SimpleNamespace(task=SimpleNamespace(goal_layout=Layout(parts, n_arms)))
        self.executed: list[NDArray[Any]] = []

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        super().reset(seed=seed)
        self.state = self.np_random.uniform(-1, 1, (self.n_arms, OBSERVATION))
        self.goal = self.np_random.uniform(-1, 1, self.n_arms * GOAL + 1)
        self.clock = 0
        return self._observe(), {}

    def step(
        self, action: NDArray[Any]
    ) -> tuple[dict[str, NDArray[Any]], float, bool, bool, dict[str, Any]]:
        self.executed.append(np.array(action))
        self.state[:, :ACTION] += 0.1 * np.asarray(action).reshape(self.n_arms, ACTION)
        self.state = np.clip(self.state, -10, 10)
        self.clock += 1
        observation = self._observe()
        reward = float(
            self.compute_reward(observation["achieved_goal"], observation["desired_goal"], {})
        )
        return observation, reward, False, self.clock >= self.horizon, {"is_success": reward == 0}

    def compute_reward(self, achieved: Any, desired: Any, info: Any) -> NDArray[Any]:
        distance = np.linalg.norm(np.asarray(achieved) - np.asarray(desired), axis=-1)
        return -(distance > 0.3).astype(np.float32)

    def executed_actions(self) -> NDArray[Any]:
        return np.array(self.executed)

    def _observe(self) -> dict[str, NDArray[Any]]:
        achieved = np.append(self.state[:, :GOAL].reshape(-1), 0.25)
        return {
            "observation": self.state.reshape(-1).astype(np.float32),
            "achieved_goal": achieved.astype(np.float32),
            "desired_goal": self.goal.astype(np.float32),
        }


def make_vec_env(n_envs: int = 4, *, subprocess: bool = False, n_arms: int = N_ARMS) -> VecEnv:
    makers = [lambda: Monitor(ToyArms(n_arms=n_arms)) for _ in range(n_envs)]
    if subprocess:
        # Forked: the children need not import torch again.
        return SubprocVecEnv(makers, start_method="fork")
    return DummyVecEnv(makers)


def make_teacher(
    seed: int = 0,
    *,
    critics: int = 2,
    name: str = "toy",
    inputs: tuple[tuple[str, int], ...] = (("observation", OBSERVATION), ("desired_goal", GOAL)),
    action_size: int = ACTION,
) -> Teacher:
    """A teacher with random weights whose actions fill the arm's box."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        networks = PolicyNetworks(
            NetworkSpec(inputs, action_size, (16, 16), (16, 16), critics, critic_layer_norm=True)
        )
        # Larger weights, so that actions differ between states.
        for layer in networks.actor:
            if isinstance(layer, torch.nn.Linear):
                layer.weight.mul_(2.0)
    if action_size == ACTION:
        networks.action_low.copy_(torch.from_numpy(ARM_LOW))
        networks.action_high.copy_(torch.from_numpy(ARM_HIGH))
    return Teacher(networks, name)


def linear_teacher(weight: float = 1.0) -> Teacher:
    """Always acts (0.25, 0.25) in [-1, 1]^2; its first critic says weight * (sum of the action)."""
    networks = PolicyNetworks(
        NetworkSpec((("observation", OBSERVATION), ("desired_goal", GOAL)), ACTION, (), (), 2)
    )
    networks.actor[0].weight.zero_()
    networks.actor[0].bias.fill_(float(np.arctanh(0.25)))
    for index, critic in enumerate(networks.critics):
        critic[0].weight.zero_()
        critic[0].bias.zero_()
        # The second critic is the more optimistic one where the actions sum to more than 0.
        critic[0].weight[0, -ACTION:] = weight * (1 + index)
    return Teacher(networks, "linear")
