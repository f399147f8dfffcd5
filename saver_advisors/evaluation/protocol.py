"""The rules by which training runs are compared: which seeds train, choose and report, on what.

Episodes are fixed by their seeds, so three ranges that do not meet keep training, the choice of a
checkpoint and the figure that is reported apart. docs/benchmark-protocol.md says it in prose.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

SELECTION_SEED: Final = 10_000
"""Checkpoints are evaluated, and chosen, on episodes from this seed up."""

SELECTION_EPISODES: Final = 100

REPORT_SEED: Final = 0
"""What is reported is measured on episodes from this seed up, which had no part in any choice."""

REPORT_EPISODES: Final = 500

EVALUATE_EVERY: Final = 25_000
"""Environment steps between evaluations: ten epochs of ours."""

TRAINING_SEED: Final = 1_000_000
"""Training takes no episode below this seed."""

SEED_STRIDE: Final = 1_000
"""Between the first seeds of two runs: room for so many environments side by side."""


def environment_text(env_id: str, env_kwargs: Mapping[str, Any]) -> str:
    """An environment for a table: ``DualJacoPush-v0, n_arms=3``.

    :param env_id: its id
    :param env_kwargs: its keyword arguments
    """
    return ", ".join([env_id, *(f"{name}={value}" for name, value in env_kwargs.items())])


def training_seed(seed: int) -> int:
    """The seed of a run's first environment; environment i has i more.

    :param seed: of the run, 0 or more
    :return: from ``TRAINING_SEED`` up, as SB3 and Gymnasium take it
    :raises ValueError: for a seed below 0 or too large
    """
    most = (2**31 - TRAINING_SEED) // SEED_STRIDE - 1
    if not 0 <= seed <= most:
        raise ValueError(f"seed={seed} must be from 0 to {most}")
    return TRAINING_SEED + SEED_STRIDE * seed
