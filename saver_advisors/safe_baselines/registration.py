"""Registration of the safe baselines with RL Zoo."""

from __future__ import annotations

from typing import Final

from saver_advisors.safe_baselines.constrained import CostConstrainedMixin
from saver_advisors.safe_baselines.cpo import CPO
from saver_advisors.safe_baselines.lagrangian import PPOLagrangian, TRPOLagrangian

ALGORITHMS: Final[dict[str, type[CostConstrainedMixin]]] = {
    "cpo": CPO,
    "trpolag": TRPOLagrangian,
    "ppolag": PPOLagrangian,
}
"""Classes by the name for RL Zoo's `--algo`, which is that of their file in zoo_configs."""

SEARCH_SPACES: Final = {"cpo": "trpo", "trpolag": "trpo", "ppolag": "ppo"}
"""The algorithm whose ranges RL Zoo's hyper-parameter search uses."""


def register_algorithms() -> None:
    """Add the safe baselines to RL Zoo's table of algorithms and to its search.

    RL Zoo reads `--algo` before it imports any package, so call this before its `train` or `enjoy`,
    in the same process.
    """
    from rl_zoo3 import ALGOS
    from rl_zoo3.hyperparams_opt import HYPERPARAMS_CONVERTER, HYPERPARAMS_SAMPLER

    ALGOS.update(ALGORITHMS)
    for name, other in SEARCH_SPACES.items():
        HYPERPARAMS_SAMPLER[name] = HYPERPARAMS_SAMPLER[other]
        HYPERPARAMS_CONVERTER[name] = HYPERPARAMS_CONVERTER[other]
