"""The multiplier follows the excess, and never goes below 0."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from saver_advisors.safe_baselines.lagrangian import LagrangeMultiplier


def adam(costs, limit, value, rate):
    """Adam by its equations, with projection."""
    first = second = 0.0
    path = []
    for t, cost in enumerate(costs, start=1):
        gradient = -(cost - limit)
        first = 0.9 * first + 0.1 * gradient
        second = 0.999 * second + 0.001 * gradient**2
        corrected = (first / (1 - 0.9**t)) / (np.sqrt(second / (1 - 0.999**t)) + 1e-8)
        value = max(0.0, value - rate * corrected)
        path.append(value)
    return path


@settings(deadline=None, max_examples=60)
@given(
    costs=st.lists(st.floats(0.0, 50.0), min_size=1, max_size=30),
    limit=st.floats(0.0, 25.0),
    initial=st.floats(0.0, 2.0),
)
def test_it_takes_the_steps_of_adam(costs, limit, initial):
    multiplier = LagrangeMultiplier(initial, 0.035)
    found = [multiplier.update(cost, limit) for cost in costs]
    np.testing.assert_allclose(found, adam(costs, limit, initial, 0.035), atol=1e-9)
    assert min(found) >= 0.0
    assert float(multiplier) == found[-1]


def test_it_rises_above_the_limit_and_falls_below_it():
    multiplier = LagrangeMultiplier(0.5, 0.1)
    assert multiplier.update(3.0, 2.0) > 0.5
    for _ in range(100):
        multiplier.update(0.0, 2.0)
    assert float(multiplier) == 0.0


@pytest.mark.parametrize(
    ("initial", "rate", "name"),
    [
        (-0.1, 0.1, "multiplier_init=-0.1"),
        (float("nan"), 0.1, "multiplier_init=nan"),
        (0.0, 0.0, "multiplier_lr=0.0"),
        (0.0, float("inf"), "multiplier_lr=inf"),
    ],
)
def test_bad_settings_are_named(initial, rate, name):
    with pytest.raises(ValueError, match=name):
        LagrangeMultiplier(initial, rate)


@given(st.floats(0, 10), st.floats(0, 5), st.floats(0, 50), st.floats(0.1, 25))
def test_the_proportional_term_answers_at_once_and_leaves_no_trace(
    initial: float, gain: float, cost: float, limit: float
) -> None:
    damped, plain = LagrangeMultiplier(initial, 0.035, gain), LagrangeMultiplier(initial, 0.035)
    assert float(damped) == float(plain) == initial
    price = damped.update(cost, limit)
    integral = plain.update(cost, limit)
    assert price == pytest.approx(max(0.0, integral + gain * (cost - limit)), abs=1e-9)
    assert damped.update(limit, limit) == pytest.approx(plain.update(limit, limit), abs=1e-9)


def test_a_saved_price_keeps_its_proportional_term() -> None:
    multiplier = LagrangeMultiplier(0.5, 0.1, 0.3)
    multiplier.update(6.0, 4.0)
    other = LagrangeMultiplier(0.0, 0.1, 0.3)
    other.load_state_dict(multiplier.state_dict())
    assert float(other) == float(multiplier) == pytest.approx(0.6 + 0.3 * 2.0)


@pytest.mark.parametrize("gain", [-0.1, float("nan"), float("inf")])
def test_a_gain_that_cannot_be_is_refused(gain: float) -> None:
    with pytest.raises(ValueError, match="multiplier_gain="):
        LagrangeMultiplier(0.5, 0.1, gain)
