"""PPO with a Lagrange multiplier on the cost of an episode."""

from __future__ import annotations

from stable_baselines3 import PPO

from saver_advisors.safe_baselines.lagrangian import LagrangianMixin


class PPOLagrangian(LagrangianMixin, PPO):
    """PPO-Lagrangian (Ray, Achiam and Amodei, 2019); constructor as PPO's.

    Besides: ``cost_limit`` (mean undiscounted sum of ``info["cost"]`` over an episode),
    ``cost_key``, ``cost_gamma``, ``cost_gae_lambda``, ``cost_net_arch``, ``n_cost_critic_updates``
    (see `CostConstrainedMixin`), ``multiplier_init`` and ``multiplier_lr`` (see `LagrangianMixin`).
    """
