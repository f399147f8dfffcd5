"""Costs of on-policy algorithms: reading them, sums over whole episodes, and the critic."""

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
                f"environment {index} reports no info[{key!r}], only {there}: a constrained "
                f"algorithm reads the cost of every step there; set cost_key for another entry"
            )
        try:
            costs[index] = np.asarray(info[key], np.float64).item()
        except (TypeError, ValueError):
            costs[index] = np.nan
        if not np.isfinite(costs[index]):
            raise ValueError(
                f"info[{key!r}]={info[key]!r} of environment {index} must be one number, and finite"
            )
    return costs


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
    :param learning_rate: of its Adam optimizer.
    """

    def __init__(self, policy: ActorCriticPolicy, learning_rate: float) -> None:
        super().__init__()
        arch = policy.net_arch
        layers = arch.get("vf", []) if isinstance(arch, dict) else arch
        self.observation_space: spaces.Space[Any] = policy.observation_space
        self.normalize_images = policy.normalize_images
        # One without weights, such as a normaliser, is nothing that costs could change.
        shared = next(policy.features_extractor.parameters(), None) is None
        extractor = policy.features_extractor if shared else policy.make_features_extractor()
        self.features_extractor: Any = extractor
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
