"""The protocol of comparisons: seeds and episodes for training, selection and reporting.

A seed determines an episode, so three disjoint ranges of seeds separate training, the selection of
checkpoints, and reported results. See docs/benchmark-protocol.md.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from typing import Any, Final

SELECTION_SEED: Final = 10_000
"""First seed of the episodes on which checkpoints are evaluated and selected."""

SELECTION_SEEDS: Final = range(SELECTION_SEED, SELECTION_SEED + 1_000)
"""All seeds for selection; no run trains on one of them, or reports one."""

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


SEEDS: Final = 5
"""Least number of seeds of a method in a comparison."""


def environment_text(env_id: str, env_kwargs: Mapping[str, Any]) -> str:
    """Format an environment for a table: ``DualJacoPush-v0, n_arms=3``.

    :param env_id: its id
    :param env_kwargs: its keyword arguments
    """
    return ", ".join([env_id, *(f"{name}={value}" for name, value in env_kwargs.items())])


MAX_RUN_SEED: Final = (2**31 - TRAINING_SEED) // SEED_STRIDE - 1
"""SB3 and Gymnasium need seeds below 2**31."""


def training_seed(seed: int, steps: int = 0) -> int:
    """Compute the seed of a run's first environment; environment i adds i.

    :param seed: of the run, from 0 to ``MAX_RUN_SEED``
    :param steps: environment steps that the run has done; after a restart in the middle of a run,
        other episodes follow
    :return: at least ``TRAINING_SEED + SEED_STRIDE * seed``, and in the range of SB3 and Gymnasium
    :raises ValueError: for a negative seed, or one that is too large
    """
    if not 0 <= seed <= MAX_RUN_SEED:
        raise ValueError(f"seed={seed} must be from 0 to {MAX_RUN_SEED}")
    first = TRAINING_SEED + SEED_STRIDE * seed
    # Spread over all the seeds that remain, so that restarts of two runs hardly ever coincide.
    spread = zlib.crc32(f"{seed} {steps}".encode()) if steps else 0
    return first + spread % (2**31 - SEED_STRIDE - first + 1)


def off_protocol(config: Mapping[str, Any], final: Mapping[str, Any] | None) -> list[str]:
    """List in which points the evaluations of a finished run deviate from the protocol.

    :param config: its settings; those that a file lacks count as the protocol's
    :param final: the evaluation of its last policy, None without one
    :return: such as ``eval_episodes 10 not 100``; empty for a run by the protocol
    """
    rules = (
        ("eval_every", config, EVALUATE_EVERY),
        ("eval_episodes", config, SELECTION_EPISODES),
        ("eval_seed", config, SELECTION_SEED),
        ("episodes", final or {}, REPORT_EPISODES),
        ("seed", final or {}, REPORT_SEED),
    )
    told = [] if final else ["no final episodes"]
    for name, values, rule in rules:
        if values.get(name, rule) != rule:
            told.append(f"{'' if values is config else 'final '}{name} {values[name]} not {rule}")
    return told


def check_selection(seed: int, episodes: int) -> None:
    """Check that the evaluations of a run use selection seeds.

    :param seed: of the first episode; the others follow consecutively
    :param episodes: per evaluation
    :raises ValueError: for an episode with another seed
    """
    last = seed + episodes - 1
    if seed not in SELECTION_SEEDS or last not in SELECTION_SEEDS:
        raise ValueError(
            f"eval_seed={seed} with eval_episodes={episodes} evaluates on seeds {seed} to {last}: "
            f"selection has the seeds {SELECTION_SEEDS[0]} to {SELECTION_SEEDS[-1]}"
        )
