"""The student's own critics, asked about actions in the states at hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm


def student_values(model: OffPolicyAlgorithm, actions: NDArray[Any]) -> NDArray[np.float32]:
    """The critics' conservative values of actions in the model's latest observation.

    :param model: DDPG, TD3, SAC or TQC in the middle of a rollout
    :param actions: (k, n_envs, action size), in the environment's units, clipped to its box
    :return: (k, n_envs, values): the least of several critics, or the mean of TQC's quantiles
    :raises TypeError: where the model has no critic
    """
    policy: Any = model.policy
    if getattr(policy, "critic", None) is None:
        raise TypeError(
            f"{type(model).__name__} has no critic of actions: use DDPG, TD3, SAC or TQC"
        )
    box = model.action_space
    assert isinstance(box, spaces.Box)
    candidates, n_envs, size = actions.shape
    flat = np.clip(actions.reshape(-1, size), box.low, box.high)
    scaled = th.as_tensor(np.asarray(policy.scale_action(flat), np.float32), device=model.device)
    assert model._last_obs is not None, "learn() resets the environments first"
    tensors, _ = policy.obs_to_tensor(model._last_obs)
    repeated = {key: value.repeat(candidates, 1) for key, value in tensors.items()}
    with th.no_grad():
        values = policy.critic(repeated, scaled)
    # TQC: (batch, critics, quantiles); the others: one (batch, values) a critic.
    least = th.stack(values).amin(dim=0) if isinstance(values, tuple) else _mean_quantile(values)
    return np.asarray(least.cpu().numpy().reshape(candidates, n_envs, -1), np.float32)


def _mean_quantile(quantiles: th.Tensor) -> th.Tensor:
    return quantiles.mean(dim=(1, 2), keepdim=False)[:, None]
