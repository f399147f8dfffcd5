"""On-policy learning under a cost limit: CPO, TRPO-Lagrangian and PPO-Lagrangian on SB3's API."""

from saver_advisors.safe_baselines.constrained import CostConstrainedMixin
from saver_advisors.safe_baselines.cpo import CPO
from saver_advisors.safe_baselines.lagrangian import (
    LagrangianMixin,
    PPOLagrangian,
    TRPOLagrangian,
)
from saver_advisors.safe_baselines.registration import ALGORITHMS, register_algorithms
from saver_advisors.safe_baselines.started_policy import StartedPolicy

__all__ = [
    "CPO",
    "PPOLagrangian",
    "TRPOLagrangian",
    "ALGORITHMS",
    "CostConstrainedMixin",
    "LagrangianMixin",
    "StartedPolicy",
    "register_algorithms",
]
