"""Our algorithms in RL Zoo's table: the stock four with advice, and the goal learners.

Each takes the constructor's arguments of its kin, and `advisor`: the arguments of `make_advisor` as
plain names and numbers, which RL Zoo reads from YAML and writes back readably::

    advisor: {strategy: mc-q, teacher: jaco-push, budget: 100000}

A goal learner's may say `warm_start: true` as well.
"""

from __future__ import annotations

from typing import Final

from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from saver_advisors.advising import (
    AdvisedDDPG,
    AdvisedSAC,
    AdvisedTD3,
    AdvisedTQC,
    build_advised,
)
from saver_advisors.learner import GoalDDPG, GoalSAC, GoalTD3, GoalTQC

ADVISED: Final = "advised_"
"""What comes before a stock algorithm's name in that of its advised twin."""

ALGORITHMS: Final[dict[str, type[OffPolicyAlgorithm]]] = {
    f"{ADVISED}ddpg": AdvisedDDPG,
    f"{ADVISED}td3": AdvisedTD3,
    f"{ADVISED}sac": AdvisedSAC,
    f"{ADVISED}tqc": AdvisedTQC,
    "goal_ddpg": build_advised(GoalDDPG),
    "goal_td3": build_advised(GoalTD3),
    "goal_sac": build_advised(GoalSAC),
    "goal_tqc": build_advised(GoalTQC),
}
"""Classes by the name that RL Zoo's `--algo` takes; without `advisor` they give no advice."""

STOCK: Final = ("ddpg", "td3", "sac", "tqc")
"""RL Zoo's own names of the algorithms that can be advised."""


def register_algorithms() -> None:
    """Add our algorithms to RL Zoo's table, and to those of its hyper-parameter search.

    RL Zoo reads `--algo` before it imports any package, so this has to happen before its `train`
    or `enjoy` is called, in the same process.
    """
    from rl_zoo3 import ALGOS
    from rl_zoo3.hyperparams_opt import HYPERPARAMS_CONVERTER, HYPERPARAMS_SAMPLER

    from saver_advisors import safe_baselines

    ALGOS.update(ALGORITHMS)
    safe_baselines.register_algorithms()
    for name in STOCK:
        HYPERPARAMS_SAMPLER[f"{ADVISED}{name}"] = HYPERPARAMS_SAMPLER[name]
        HYPERPARAMS_CONVERTER[f"{ADVISED}{name}"] = HYPERPARAMS_CONVERTER[name]
