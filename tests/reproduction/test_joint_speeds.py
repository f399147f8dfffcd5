"""Speeds of joints against the makers' limits, and what the pages say about them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from reproduction.joint_speeds import (
    KIND,
    OVERSHOOT,
    measured_row,
    policy_for,
    row_of,
    speed_ratios,
)
from reproduction.pages.environments import environment_page
from saver_advisors.cli.catalogue import entry


def test_a_joint_that_is_driven_at_twice_its_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    def first_joint(*_: Any) -> Any:
        return lambda seen: np.tile([1.0, 0, 0, 0, 0, 0], (len(seen["observation"]), 1))

    def still(*_: Any) -> Any:
        return lambda seen: np.zeros((len(seen["observation"]), 3))

    monkeypatch.setattr("saver_advisors.cli.policies.resolve", still)
    assert speed_ratios("JacoPush-v0", "still", 2, rated=False).max() < 0.1
    from saver_envs import registration

    made = registration.make_episodes

    def by_joints(env_id: str, n: int, rated: bool) -> Any:
        return made(env_id, n, rated=rated, control="joints", max_speed=0.4)

    monkeypatch.setattr("saver_advisors.cli.policies.resolve", first_joint)
    monkeypatch.setattr("saver_envs.registration.make_episodes", by_joints)
    ratios = speed_ratios("JacoPush-v0", "first joint", 2, rated=False)
    assert ratios.shape == (50, 2)
    # 2 on average; the targets move in steps, so the first of the four samples is the fastest.
    assert 2.0 < np.median(ratios[5:20]) < 2.8


def test_rated_keeps_the_limits_that_the_default_exceeds() -> None:
    row = row_of("JacoPush-v0", 3)
    assert row["policy"] == "jaco-push"
    assert row["default_share"] > 0.1
    assert row["default_highest"] > 2
    assert row["rated_share"] == 0
    assert row["rated_highest"] <= OVERSHOOT
    results = [{"kind": KIND, "rows": [row]}]
    told = environment_page(entry("JacoPush-v0"), results)
    assert f"in {row['default_share']:.0%} of the steps of `jaco-push` (3 episodes)" in told
    assert "with `rated=True`, which limits the joints' targets, in 0.0%" in told
    assert measured_row("DualJacoPush-v0", results) is None


def test_an_id_without_weights_is_played_by_its_expert() -> None:
    assert policy_for("DualMicoPush-v0") == "expert"
    assert policy_for("DualJacoPush-v0") == "dual-jaco-push"
