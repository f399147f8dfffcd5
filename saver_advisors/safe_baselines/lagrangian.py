"""PPO and TRPO with a Lagrange multiplier on the cost of an episode, learned by Adam."""

from __future__ import annotations

import math
from typing import Any

import torch as th
from sb3_contrib import TRPO
from stable_baselines3 import PPO
from torch import nn

from saver_advisors.safe_baselines.constrained import CostConstrainedMixin
from saver_advisors.safe_baselines.costs import Array


class LagrangeMultiplier(nn.Module):
    """A Lagrange multiplier on cost, which rises while the cost exceeds its limit.

    Gradient ascent of lambda (J_c - d), with Adam, projected to lambda >= 0. This is integral
    control, which oscillates. A proportional term damps it: the multiplier in use is
    max(0, lambda + gain (J_c - d)) (Stooke, Achiam and Abbeel, "Responsive Safety in Reinforcement
    Learning by PID Lagrangian Methods", arXiv 2007.03964).

    :param initial: value before the first update, at least 0.
    :param learning_rate: of Adam, above 0.
    :param gain: of the proportional term, per unit of cost, at least 0.
    :raises ValueError: if an argument is out of range.
    """

    excess: th.Tensor
    """J_c - d of the last update."""

    def __init__(self, initial: float, learning_rate: float, gain: float = 0.0) -> None:
        super().__init__()
        for name, value in (("init", initial), ("gain", gain)):
            if not (math.isfinite(value) and value >= 0.0):
                raise ValueError(f"multiplier_{name}={value} must be a finite number of at least 0")
        if not (math.isfinite(learning_rate) and learning_rate > 0.0):
            raise ValueError(f"multiplier_lr={learning_rate} must be a finite number above 0")
        self.gain = gain
        # Double precision: small steps are not lost on a large multiplier.
        self.value = nn.Parameter(th.tensor(float(initial), dtype=th.float64))
        # A buffer: a resumed run restores it.
        self.register_buffer("excess", th.zeros((), dtype=th.float64))
        self.optimizer = th.optim.Adam([self.value], lr=learning_rate)

    def update(self, mean_cost: float, cost_limit: float) -> float:
        """Take one step.

        :param mean_cost: J_c, mean sum of cost of an episode.
        :param cost_limit: d.
        :return: the multiplier in use.
        """
        self.excess.fill_(mean_cost - cost_limit)
        self.optimizer.zero_grad()
        loss = -self.value * (mean_cost - cost_limit)
        loss.backward()
        self.optimizer.step()
        with th.no_grad():
            self.value.clamp_(min=0.0)
        return float(self)

    def __float__(self) -> float:
        return max(0.0, float(self.value.detach()) + self.gain * float(self.excess))


class LagrangianMixin(CostConstrainedMixin):
    """Learn with (A - lambda A_c) / (1 + lambda) instead of the advantages A.

    A is standardised over the rollout (if ``normalize_advantage``); the advantages of costs A_c are
    centred only, so that lambda keeps the unit of costs. The multiplier is updated before the
    policy.

    :param args: as for the algorithm.
    :param multiplier_init: lambda before the first update, at least 0.
    :param multiplier_lr: learning rate of its Adam optimizer.
    :param multiplier_gain: of the proportional term, per unit of cost, at least 0.
    :param kwargs: as for the algorithm and `CostConstrainedMixin`.
    """

    multiplier: LagrangeMultiplier
    normalize_advantage: bool
    batch_size: int

    def __init__(
        self,
        *args: Any,
        multiplier_init: float = 0.001,
        multiplier_lr: float = 0.035,
        multiplier_gain: float = 0.0,
        **kwargs: Any,
    ) -> None:
        self.multiplier_init = multiplier_init
        self.multiplier_lr = multiplier_lr
        self.multiplier_gain = multiplier_gain
        super().__init__(*args, **kwargs)

    def _setup_model(self) -> None:
        self.multiplier = LagrangeMultiplier(
            self.multiplier_init, self.multiplier_lr, self.multiplier_gain
        )
        super()._setup_model()

    def train(self) -> None:
        """Update multiplier, policy and critics with the last rollout."""
        if self.mean_episode_cost is not None:
            self.multiplier.update(self.mean_episode_cost, self.cost_limit)
        self.rollout_buffer.advantages = self._penalized_advantages()
        # Standardising the mixture would change the unit of lambda.
        wanted, self.normalize_advantage = self.normalize_advantage, False
        try:
            super().train()
        finally:
            self.normalize_advantage = wanted
        self._train_cost_critic(self.batch_size)
        self.logger.record("train/lagrange_multiplier", float(self.multiplier))

    def _penalized_advantages(self) -> Array:
        """Combine the advantages of rewards and costs, (n_steps, n_envs)."""
        reward, cost = self.rollout_buffer.advantages, self._cost_rollout.advantages
        if self.normalize_advantage:
            reward = (reward - reward.mean()) / (reward.std() + 1e-8)
        multiplier = float(self.multiplier)
        mixed: Array = (reward - multiplier * (cost - cost.mean())) / (1.0 + multiplier)
        return mixed.astype(cost.dtype)

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "multiplier"]

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        state_dicts, variables = super()._get_torch_save_params()
        return [*state_dicts, "multiplier", "multiplier.optimizer"], variables


class PPOLagrangian(LagrangianMixin, PPO):
    """PPO-Lagrangian (Ray, Achiam and Amodei, 2019); constructor as PPO's.

    Additional arguments: ``cost_limit`` (mean undiscounted sum of ``info["cost"]`` over an
    episode), ``cost_key``, ``cost_gamma``, ``cost_gae_lambda``, ``cost_net_arch``,
    ``n_cost_critic_updates`` (see `CostConstrainedMixin`), ``multiplier_init``, ``multiplier_lr``
    and ``multiplier_gain`` (see `LagrangianMixin`).
    """


class TRPOLagrangian(LagrangianMixin, TRPO):
    """TRPO-Lagrangian (Ray, Achiam and Amodei, 2019); constructor as sb3-contrib's TRPO's.

    Additional arguments as for `PPOLagrangian`.
    """
