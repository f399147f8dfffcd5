"""The safe baselines in RL Zoo's table."""

from __future__ import annotations

from typing import Final

from saver_advisors.safe_baselines.constrained import CostConstrainedMixin
from saver_advisors.safe_baselines.cpo import CPO
from saver_advisors.safe_baselines.ppo_lagrangian import PPOLagrangian
from saver_advisors.safe_baselines.trpo_lagrangian import TRPOLagrangian

ALGORITHMS: Final[dict[str, type[CostConstrainedMixin]]] = {
    "cpo": CPO,
    "trpolag": TRPOLagrangian,
    "ppolag": PPOLagrangian,
}
"""Classes by the name that RL Zoo's `--algo` takes, which is that of their file in zoo_configs."""

KIN: Final = {"cpo": "trpo", "trpolag": "trpo", "ppolag": "ppo"}
"""Whose ranges RL Zoo's hyper-parameter search takes."""


def register_algorithms() -> None:
    """Add the safe baselines to RL Zoo's table of algorithms and to its search.

    RL Zoo reads `--algo` before it imports any package, so this has to happen before its `train`
    or `enjoy` is called, in the same process.
    """
    from rl_zoo3 import ALGOS
    from rl_zoo3.hyperparams_opt import HYPERPARAMS_CONVERTER, HYPERPARAMS_SAMPLER

    ALGOS.update(ALGORITHMS)
    for name, kin in KIN.items():
        HYPERPARAMS_SAMPLER[name] = HYPERPARAMS_SAMPLER[kin]
        HYPERPARAMS_CONVERTER[name] = HYPERPARAMS_CONVERTER[kin]
