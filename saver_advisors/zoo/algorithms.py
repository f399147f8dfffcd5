"""Our algorithms in RL Zoo's table: SB3's four with advice, and the goal learners.

Each accepts its base class's arguments and `advisor`: the arguments of `make_advisor` as plain
names and numbers, which RL Zoo reads from YAML and writes back readably::

    advisor: {strategy: mc-q, teacher: jaco-push, budget: 100000}

A goal learner also accepts `warm_start: true` there.
"""

from __future__ import annotations

from typing import Final

from sb3_contrib import TQC
from stable_baselines3 import DDPG, SAC, TD3
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from saver_advisors import safe_baselines
from saver_advisors.advising import build_advised
from saver_advisors.training.building import ALGORITHMS as GOAL_LEARNERS

ADVISED: Final = "advised_"
"""Prefix of the advised variants of RL Zoo's own algorithms."""

STOCK: Final[dict[str, type[OffPolicyAlgorithm]]] = {
    "ddpg": DDPG,
    "td3": TD3,
    "sac": SAC,
    "tqc": TQC,
}
"""RL Zoo's own algorithms that can be advised, by its names."""

ALGORITHMS: Final[dict[str, type[OffPolicyAlgorithm]]] = {
    **{f"{ADVISED}{name}": build_advised(algorithm) for name, algorithm in STOCK.items()},
    **{f"goal_{name}": build_advised(algorithm) for name, algorithm in GOAL_LEARNERS.items()},
}
"""Classes by their names for RL Zoo's `--algo`; without `advisor` they give no advice."""


def register_algorithms() -> None:
    """Add our algorithms to RL Zoo's table and to its hyper-parameter search.

    RL Zoo reads `--algo` before it imports any package, so call this in the same process before
    its `train` or `enjoy`.
    """
    safe_baselines.register_algorithms()
    safe_baselines.register_algorithms(ALGORITHMS, {f"{ADVISED}{name}": name for name in STOCK})
