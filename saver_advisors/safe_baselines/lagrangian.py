"""What PPO-Lagrangian and TRPO-Lagrangian share: a price on costs, in the advantages."""

from __future__ import annotations

from typing import Any

from saver_advisors.safe_baselines.constrained import CostConstrainedMixin
from saver_advisors.safe_baselines.costs import Array
from saver_advisors.safe_baselines.lagrange import LagrangeMultiplier


class LagrangianMixin(CostConstrainedMixin):
    """Learns with (A - lambda A_c) / (1 + lambda) in place of the advantages A.

    A is standardised over the rollout (where ``normalize_advantage``), the advantages of costs A_c
    are centred only, so that lambda stays a price of costs in their own unit. The multiplier is
    updated before the policy is.

    :param args: as for the algorithm
    :param multiplier_init: lambda before the first update, at least 0
    :param multiplier_lr: learning rate of its Adam optimizer
    :param multiplier_gain: what an excess cost of 1 adds to the price at once, at least 0
    :param kwargs: as for the algorithm and `CostConstrainedMixin`
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
        # The algorithm would standardise the mixture, and lambda would lose its meaning.
        wanted, self.normalize_advantage = self.normalize_advantage, False
        try:
            super().train()
        finally:
            self.normalize_advantage = wanted
        self._train_cost_critic(self.batch_size)
        self.logger.record("train/lagrange_multiplier", float(self.multiplier))

    def _penalized_advantages(self) -> Array:
        """(n_steps, n_envs)."""
        reward, cost = self.rollout_buffer.advantages, self._cost_rollout.advantages
        if self.normalize_advantage:
            reward = (reward - reward.mean()) / (reward.std() + 1e-8)
        price = float(self.multiplier)
        mixed: Array = (reward - price * (cost - cost.mean())) / (1.0 + price)
        return mixed.astype(cost.dtype)

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "multiplier"]

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        state_dicts, variables = super()._get_torch_save_params()
        return [*state_dicts, "multiplier", "multiplier.optimizer"], variables
