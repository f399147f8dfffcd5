"""Registration of the safe baselines with RL Zoo."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from stable_baselines3.common.base_class import BaseAlgorithm

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


def register_algorithms(
    algorithms: Mapping[str, type[BaseAlgorithm]] = ALGORITHMS,
    search_spaces: Mapping[str, str] = SEARCH_SPACES,
) -> None:
    """Add algorithms, by default the safe baselines, to RL Zoo's table and to its search.

    RL Zoo reads `--algo` before it imports any package, so call this before its `train` or `enjoy`,
    in the same process.

    :param algorithms: classes by name.
    :param search_spaces: for an algorithm, the one whose ranges the search uses.
    """
    from rl_zoo3 import ALGOS
    from rl_zoo3.hyperparams_opt import HYPERPARAMS_CONVERTER, HYPERPARAMS_SAMPLER

    ALGOS.update(algorithms)
    for name, other in search_spaces.items():
        HYPERPARAMS_SAMPLER[name] = HYPERPARAMS_SAMPLER[other]
        HYPERPARAMS_CONVERTER[name] = HYPERPARAMS_CONVERTER[other]
