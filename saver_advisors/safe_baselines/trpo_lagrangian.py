"""TRPO with a Lagrange multiplier on the cost of an episode."""

from __future__ import annotations

from sb3_contrib import TRPO

from saver_advisors.safe_baselines.lagrangian import LagrangianMixin


class TRPOLagrangian(LagrangianMixin, TRPO):
    """TRPO-Lagrangian (Ray, Achiam and Amodei, 2019); constructor as sb3-contrib's TRPO's.

    Besides: ``cost_limit`` (mean undiscounted sum of ``info["cost"]`` over an episode),
    ``cost_key``, ``cost_gamma``, ``cost_gae_lambda``, ``cost_net_arch``, ``n_cost_critic_updates``
    (see `CostConstrainedMixin`), ``multiplier_init`` and ``multiplier_lr`` (see `LagrangianMixin`).
    """
