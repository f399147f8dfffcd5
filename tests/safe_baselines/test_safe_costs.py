"""Costs of steps and their sums over episodes."""

from __future__ import annotations

import numpy as np
import pytest

from saver_advisors.safe_baselines.costs import EpisodeCosts, read_costs


def test_sums_run_on_across_rollouts_and_leave_out_torn_episodes():
    episodes = EpisodeCosts(2)
    episodes.add(np.array([1.0, 5.0]), np.array([False, False]))
    episodes.add(np.array([2.0, 5.0]), np.array([True, False]))
    assert [list(one) for one in episodes.take()] == [[3.0], [2]]
    episodes.add(np.array([4.0, 5.0]), np.array([False, True]))
    assert [list(one) for one in episodes.take()] == [[15.0], [3]]
    episodes.interrupt()
    episodes.add(np.array([1.0, 1.0]), np.array([True, True]))
    assert [list(one) for one in episodes.take()] == [[], []]
    episodes.add(np.array([1.0, 1.0]), np.array([True, False]))
    assert [list(one) for one in episodes.take()] == [[1.0], [1]]
    episodes.restart()
    episodes.add(np.array([0.0, 2.0]), np.array([False, True]))
    assert [list(one) for one in episodes.take()] == [[2.0], [1]]


@pytest.mark.parametrize(
    ("info", "words"),
    [
        ({"is_success": False}, "no info\\['cost'\\]"),
        ({}, "nothing"),
        ({"cost": float("nan")}, "finite"),
        ({"cost": float("inf")}, "finite"),
        ({"cost": "much"}, "one number"),
        ({"cost": None}, "finite"),
        ({"cost": np.zeros(2)}, "one number"),
    ],
)
def test_a_cost_that_is_none_is_refused(info, words):
    with pytest.raises(ValueError, match=words) as caught:
        read_costs([{"cost": 1.0}, info], "cost")
    assert "environment 1" in str(caught.value)


def test_costs_of_any_number_type_are_read():
    infos = [{"cost": one} for one in (1, True, np.float32(0.5), np.array([2.0]), np.int64(3))]
    assert read_costs(infos, "cost").tolist() == [1.0, 1.0, 0.5, 2.0, 3.0]
