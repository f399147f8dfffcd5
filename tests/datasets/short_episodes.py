"""What tests of data sets share: episodes of six steps, and how they are compared."""

from __future__ import annotations

from typing import Any

import numpy as np

from saver_advisors.cli.policies import resolve
from saver_advisors.datasets.actors import Actor
from saver_advisors.datasets.recorded_episodes import RecordedEpisode, record_episodes

SHORT: dict[str, Any] = {"max_episode_steps": 6}
SEEDS = range(1_000_000, 1_000_003)


def expert(env_id: str = "JacoPush-v0", **options: Any) -> Actor:
    return Actor(resolve("expert", env_id, {**SHORT, **options}))


def recorded(actor: Actor, env_id: str = "JacoPush-v0", **options: Any) -> list[RecordedEpisode]:
    return list(record_episodes(actor, env_id, SEEDS, {**SHORT, **options}))


def assert_same(one: Any, other: Any) -> None:
    """Compare arrays and nested mappings of them, types included."""
    if isinstance(one, dict):
        assert set(one) == set(other)
        for name, values in one.items():
            assert_same(values, other[name])
    else:
        np.testing.assert_array_equal(one, other, strict=True)
