"""The cost critic: expected discounted cost from a state on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch as th
from gymnasium import spaces
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.preprocessing import preprocess_obs
from stable_baselines3.common.torch_layers import create_mlp
from stable_baselines3.common.type_aliases import PyTorchObs
from torch import nn


def value_layers(policy: ActorCriticPolicy) -> list[int]:
    """The widths of a policy's own value network."""
    layers = policy.net_arch
    return list(layers.get("vf", [])) if isinstance(layers, dict) else list(layers)


class CostCritic(nn.Module):
    """A network of its own beside the policy's value network: same inputs, same kind of layers.

    :param policy: whose observation space, features extractor and activation are taken; no weight
        is shared, so that costs do not disturb what the policy sees
    :param layers: widths of the hidden layers
    :param learning_rate: of its Adam optimizer
    """

    def __init__(
        self, policy: ActorCriticPolicy, layers: Sequence[int], learning_rate: float
    ) -> None:
        super().__init__()
        self.observation_space: spaces.Space[Any] = policy.observation_space
        self.normalize_images = policy.normalize_images
        self.features_extractor = policy.make_features_extractor()
        width = self.features_extractor.features_dim
        self.layers = nn.Sequential(*create_mlp(width, 1, list(layers), policy.activation_fn))
        self.to(policy.device)
        self.optimizer = th.optim.Adam(self.parameters(), lr=learning_rate, eps=1e-5)

    def forward(self, observation: PyTorchObs) -> th.Tensor:
        """
        :param observation: batch of n, as the policy takes it
        :return: (n,) expected discounted cost
        """
        prepared = preprocess_obs(
            observation, self.observation_space, normalize_images=self.normalize_images
        )
        values: th.Tensor = self.layers(self.features_extractor(prepared))
        return values.squeeze(-1)
