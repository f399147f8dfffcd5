"""Costs of on-policy algorithms: the critic, the rollout, and the sums over whole episodes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.preprocessing import preprocess_obs
from stable_baselines3.common.torch_layers import create_mlp
from stable_baselines3.common.type_aliases import PyTorchObs
from torch import nn

Array = NDArray[np.float32]


def read_costs(infos: Sequence[dict[str, Any]], key: str) -> Array:
    """Read the costs of one step.

    :param infos: one per environment.
    :param key: the entry that holds the cost.
    :return: (n_envs,).
    :raises ValueError: if an entry is missing, not a number, infinite or NaN.
    """
    costs = np.zeros(len(infos), np.float32)
    for index, info in enumerate(infos):
        if key not in info:
            there = ", ".join(sorted(info)) or "nothing"
            raise ValueError(
                f"environment {index} reports no info[{key!r}] (there is {there}): a constrained "
                f"algorithm needs the cost of every step there, or cost_key to name another entry"
            )
        try:
            costs[index] = np.asarray(info[key], np.float64).item()
        except (TypeError, ValueError):
            raise ValueError(
                f"info[{key!r}]={info[key]!r} of environment {index} must be one number"
            ) from None
        if not np.isfinite(costs[index]):
            raise ValueError(
                f"info[{key!r}]={info[key]!r} of environment {index} must be a finite number: no "
                f"constraint can be checked against it"
            )
    return costs


def generalized_advantages(
    signal: Array,
    values: Array,
    last_values: Array,
    episode_starts: NDArray[Any],
    dones: NDArray[Any],
    gamma: float,
    gae_lambda: float,
) -> Array:
    """Compute generalized advantage estimates (Schulman et al., 2016) of rewards or costs.

    :param signal: (steps, n_envs) reward or cost of each step, plus gamma times the value of the
        last state if a time limit truncated the episode.
    :param values: (steps, n_envs) of the states before each step.
    :param last_values: (n_envs,) of the states after the last step.
    :param episode_starts: (steps, n_envs) whether a step is the first of its episode.
    :param dones: (n_envs,) whether the last step ended its episode.
    :param gamma: discount.
    :param gae_lambda: 0 for one-step differences, 1 for whole returns.
    :return: (steps, n_envs); their sum with ``values`` is the target of a value function.
    """
    advantages = np.zeros_like(values)
    following = np.zeros_like(last_values)
    goes_on = 1.0 - np.asarray(dones, np.float32)
    next_values = last_values
    for step in reversed(range(len(signal))):
        difference = signal[step] + gamma * goes_on * next_values - values[step]
        following = difference + gamma * gae_lambda * goes_on * following
        advantages[step] = following
        goes_on = 1.0 - np.asarray(episode_starts[step], np.float32)
        next_values = values[step]
    return advantages


class CostRollout:
    """The costs of the steps of SB3's rollout buffer, in the same order.

    :param n_steps: of a rollout, per environment.
    :param n_envs: number of environments.
    """

    def __init__(self, n_steps: int, n_envs: int) -> None:
        self.costs = np.zeros((n_steps, n_envs), np.float32)
        self.values = np.zeros((n_steps, n_envs), np.float32)
        self.advantages = np.zeros((n_steps, n_envs), np.float32)
        self.episode_starts = np.zeros((n_steps, n_envs), bool)
        self.position = 0

    @property
    def returns(self) -> Array:
        """(n_steps, n_envs) targets of the cost critic."""
        targets: Array = self.advantages + self.values
        return targets

    def reset(self) -> None:
        """Begin a rollout."""
        self.position = 0

    def add(self, costs: Array, values: Array, episode_starts: NDArray[Any]) -> None:
        """Store a step.

        :param costs: (n_envs,), with the bootstrap value of truncated episodes.
        :param values: (n_envs,) the cost critic's, of the states before the step.
        :param episode_starts: (n_envs,) whether the step is the first of its episode.
        """
        self.costs[self.position] = costs
        self.values[self.position] = values
        self.episode_starts[self.position] = episode_starts
        self.position += 1

    def finish(
        self, last_values: Array, dones: NDArray[Any], gamma: float, gae_lambda: float
    ) -> None:
        """Compute the advantages of a full rollout; see :func:`generalized_advantages`."""
        assert self.position == len(self.costs), "the rollout is not full"
        self.advantages = generalized_advantages(
            self.costs, self.values, last_values, self.episode_starts, dones, gamma, gae_lambda
        )


class EpisodeCosts:
    """Undiscounted sums of cost over episodes, which may span several rollouts.

    :param n_envs: number of environments.
    """

    def __init__(self, n_envs: int) -> None:
        self._sums = np.zeros(n_envs)
        self._lengths = np.zeros(n_envs, np.int64)
        self._whole = np.ones(n_envs, bool)
        self._ended: list[tuple[float, int]] = []

    def restart(self) -> None:
        """Discard the running episodes, since all environments were reset."""
        self._sums[:] = 0.0
        self._lengths[:] = 0
        self._whole[:] = True

    def interrupt(self) -> None:
        """Exclude the running episodes, since a step of them was lost."""
        self._whole[:] = False

    def add(self, costs: Array, dones: NDArray[Any]) -> None:
        """Count a step.

        :param costs: (n_envs,) as the environments reported them.
        :param dones: (n_envs,) whether the step ended its episode.
        """
        self._sums += costs
        self._lengths += 1
        for index in np.flatnonzero(dones):
            if self._whole[index]:
                self._ended.append((float(self._sums[index]), int(self._lengths[index])))
            self._sums[index], self._lengths[index], self._whole[index] = 0.0, 0, True

    def take(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return the episodes that ended since the last call.

        :return: their sums of cost and their lengths in steps, (episodes,) each.
        """
        ended, self._ended = self._ended, []
        sums = np.array([one[0] for one in ended], np.float64)
        return sums, np.array([one[1] for one in ended], np.int64)


class CostCritic(nn.Module):
    """The expected discounted cost of a state, with inputs and layers like the value network's.

    :param policy: provides observation space, features extractor and activation; no weight is
        shared, so that costs do not change the policy's features.
    :param layers: widths of the hidden layers; the policy's value network's if None.
    :param learning_rate: of its Adam optimizer.
    """

    def __init__(
        self, policy: ActorCriticPolicy, layers: Sequence[int] | None, learning_rate: float
    ) -> None:
        super().__init__()
        if layers is None:
            arch = policy.net_arch
            layers = arch.get("vf", []) if isinstance(arch, dict) else arch
        self.observation_space: spaces.Space[Any] = policy.observation_space
        self.normalize_images = policy.normalize_images
        self.features_extractor = policy.make_features_extractor()
        width = self.features_extractor.features_dim
        self.layers = nn.Sequential(*create_mlp(width, 1, list(layers), policy.activation_fn))
        self.to(policy.device)
        self.optimizer = th.optim.Adam(self.parameters(), lr=learning_rate, eps=1e-5)

    def forward(self, observation: PyTorchObs) -> th.Tensor:
        """Evaluate a batch.

        :param observation: n observations, as for the policy.
        :return: (n,) expected discounted cost.
        """
        prepared = preprocess_obs(
            observation, self.observation_space, normalize_images=self.normalize_images
        )
        values: th.Tensor = self.layers(self.features_extractor(prepared))
        return values.squeeze(-1)
