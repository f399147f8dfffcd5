"""The protocol of comparisons: seeds and episodes for training, selection and reporting.

A seed determines an episode, so three disjoint ranges of seeds separate training, the selection of
checkpoints, and reported results. See docs/benchmark-protocol.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

SELECTION_SEED: Final = 10_000
"""First seed of the episodes on which checkpoints are evaluated and selected."""

SELECTION_EPISODES: Final = 100

REPORT_SEED: Final = 0
"""First seed of the episodes of reported results, which no selection uses."""

REPORT_EPISODES: Final = 500

EVALUATE_EVERY: Final = 25_000
"""Environment steps between evaluations: ten epochs."""

TRAINING_SEED: Final = 1_000_000
"""First seed of the episodes for training."""

SEED_STRIDE: Final = 1_000
"""Distance between the first seeds of two runs, and so the most environments per run."""


def environment_text(env_id: str, env_kwargs: Mapping[str, Any]) -> str:
    """Format an environment for a table: ``DualJacoPush-v0, n_arms=3``.

    :param env_id: its id
    :param env_kwargs: its keyword arguments
    """
    return ", ".join([env_id, *(f"{name}={value}" for name, value in env_kwargs.items())])


def training_seed(seed: int) -> int:
    """Compute the seed of a run's first environment; environment i adds i.

    :param seed: of the run, at least 0
    :return: at least ``TRAINING_SEED``, and in the range of SB3 and Gymnasium
    :raises ValueError: for a negative seed, or one that is too large
    """
    most = (2**31 - TRAINING_SEED) // SEED_STRIDE - 1
    if not 0 <= seed <= most:
        raise ValueError(f"seed={seed} must be from 0 to {most}")
    return TRAINING_SEED + SEED_STRIDE * seed
