"""A shield keeps the constraint of a task, and leaves alone what keeps it anyway."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from saver_advisors.evaluation.episodes import Observation, evaluate_policy
from saver_advisors.evaluation.shield import Shield
from saver_advisors.pretrained import load_teacher, side_by_side
from saver_envs.registration import make_episodes

DISTANCE = "DualJacoDistance-v0"


def gentle(observation: Observation) -> NDArray[np.float64]:
    return np.full((len(observation["observation"]), 8), 0.1)


def test_pickers_leave_the_band_much_less_with_a_shield() -> None:
    pair = side_by_side(load_teacher("jaco-pick-and-place"), 2)

    def pickers(observation: Observation) -> NDArray[Any]:
        return np.asarray(pair.predict(observation)[0])

    without, kept = (
        evaluate_policy(pickers, DISTANCE, episodes=4, guard=one) for one in (None, Shield)
    )
    assert without.constraint_met_rate == 0.0
    assert kept.constraint_met_rate is not None and kept.constraint_met_rate >= 0.25
    costs = (one.cost_sums["cost_distance"].mean() for one in (kept, without))
    assert next(costs) < next(costs) / 3


def test_what_keeps_the_constraint_is_executed_as_it_is() -> None:
    """Trying actions leaves no trace in the episodes."""
    options: dict[str, Any] = {"episodes": 2, "env_kwargs": {"max_episode_steps": 6}}
    without, kept = (
        evaluate_policy(gentle, DISTANCE, guard=one, **options) for one in (None, Shield)
    )
    assert without.cost_sums["cost_distance"].max() == 0
    np.testing.assert_array_equal(kept.final_distances, without.final_distances)
    np.testing.assert_array_equal(kept.deviations, without.deviations)


def test_a_task_without_a_constraint_is_named() -> None:
    with pytest.raises(ValueError, match="'push' has none"):
        Shield(gentle, make_episodes("DualJacoPush-v0", 1))
