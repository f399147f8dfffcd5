"""PPO and TRPO with a Lagrange multiplier on the cost of an episode, learned by Adam."""

from __future__ import annotations

from typing import Any

from sb3_contrib import TRPO
from stable_baselines3 import PPO

from saver_advisors.learner.multiplier import LagrangeMultiplier
from saver_advisors.safe_baselines.constrained import CostConstrainedMixin
from saver_advisors.safe_baselines.costs import Array


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
    episode), ``cost_key``, ``cost_gamma``, ``cost_gae_lambda``,
    ``n_cost_critic_updates`` (see `CostConstrainedMixin`), ``multiplier_init``, ``multiplier_lr``
    and ``multiplier_gain`` (see `LagrangianMixin`).
    """


class TRPOLagrangian(LagrangianMixin, TRPO):
    """TRPO-Lagrangian (Ray, Achiam and Amodei, 2019); constructor as sb3-contrib's TRPO's.

    Additional arguments as for `PPOLagrangian`.
    """
