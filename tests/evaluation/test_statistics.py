from __future__ import annotations

import itertools
import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from saver_advisors.evaluation.statistics import (
    Estimate,
    difference,
    estimate,
    probability_of_improvement,
    ratio,
    worst_mean,
)

rates = st.integers(0, 100).map(lambda hits: hits / 100)
some_seeds = st.lists(rates, min_size=1, max_size=6)


def iqm(values):
    return estimate(values).value


def test_interquartile_means_by_hand():
    assert iqm([0, 4, 5, 100]) == 4.5  # one of four is left out at each end
    assert iqm([1, 2, 9]) == 4  # of three none is
    assert iqm([7]) == 7
    # Of nine, two at each end: the mean of the five in the middle.
    assert iqm([9, 8, 7, 6, 5, 4, 3, 2, -100]) == 5


def test_one_seed_has_a_value_and_no_interval():
    one = estimate([0.95])
    assert one == Estimate(0.95, None, 1)
    assert one.interval is None
    assert one.text() == "0.95"
    assert not one.excludes(0.0)
    assert one.to_mapping() == {"value": 0.95, "ci95": None, "n": 1}


def test_the_interval_of_two_seeds_reaches_from_one_to_the_other():
    # Drawn with replacement: both, or one of them twice with probability 1/4 each, above 2.5%.
    two = estimate([0.9, 1.0])
    assert two.value == pytest.approx(0.95)
    assert two.interval == pytest.approx((0.9, 1.0))
    assert two.n == 2
    assert two.text(1, scale=100) == "95.0 [90.0, 100.0]"
    assert two.excludes(0.8)
    assert not two.excludes(0.95)
    assert json.loads(json.dumps(two.to_mapping()))["ci95"] == pytest.approx([0.9, 1.0])


def test_the_interval_is_that_of_all_possible_draws():
    # Five seeds have 3,125 draws: their percentiles, counted out, are what the bootstrap estimates.
    seeds = np.array([0.2, 0.5, 0.6, 0.7, 0.95])
    draws = [iqm(draw) for draw in itertools.product(seeds, repeat=5)]
    found = estimate(seeds)
    assert found.value == pytest.approx(0.6)  # 0.5, 0.6, 0.7
    assert found.interval == pytest.approx(np.percentile(draws, [2.5, 97.5]), abs=0.02)


def test_probability_of_improvement_by_hand():
    # Of the six pairs x wins four and ties one.
    found = probability_of_improvement([3, 5, 6], [4, 3])
    assert found.value == pytest.approx(4.5 / 6)
    assert found.n == 2
    low, high = found.interval
    assert 0 <= low <= found.value <= high <= 1
    assert probability_of_improvement([1, 1], [0, 0]).interval == (1, 1)


def test_differences_and_ratios_by_hand():
    assert difference([4, 6], [1, 3]).value == 3
    assert difference([4, 6], [1, 3]).interval == (1, 5)
    assert ratio([4, 6], [1, 3]).value == 2.5
    assert ratio([4, 4], [2, 2]).interval == (2, 2)
    with pytest.raises(ValueError, match="y="):
        ratio([1, 2], [0, 1])


@pytest.mark.parametrize("of", [difference, ratio, probability_of_improvement])
def test_a_single_run_on_either_side_leaves_no_interval(of):
    # Drawing the other side alone would look surer than anybody can be.
    assert of([1.0], [2.0, 3.0]).interval is None
    assert of([1.0, 2.0], [3.0]).interval is None
    assert of([1.0, 2.0], [3.0]).n == 1
    assert of([1.0, 2.0], [3.0, 4.0]).interval is not None


@given(some_seeds, some_seeds)
def test_the_probability_of_the_opposite_is_the_rest(x, y):
    there = probability_of_improvement(x, y).value
    back = probability_of_improvement(y, x).value
    assert there + back == pytest.approx(1)
    assert probability_of_improvement(x, x).value == 0.5


@given(some_seeds, st.sampled_from([2.0, -1.0, 0.5]), st.integers(-3, 3))
def test_the_mean_moves_with_its_values(seeds, factor, shift):
    moved = iqm([factor * seed + shift for seed in seeds])
    assert moved == pytest.approx(factor * iqm(seeds) + shift)
    assert min(seeds) - 1e-12 <= iqm(seeds) <= max(seeds) + 1e-12


@settings(max_examples=20, deadline=None)
@given(st.lists(rates, min_size=2, max_size=6))
def test_an_interval_lies_among_its_seeds_and_repeats(seeds):
    found = estimate(seeds)
    low, high = found.interval
    assert min(seeds) - 1e-9 <= low <= high <= max(seeds) + 1e-9
    assert estimate(seeds) == found


@pytest.mark.parametrize("values", [[], [1.0, math.nan], 1.0, np.zeros((1, 1))])
def test_what_is_no_sample_is_refused(values):
    with pytest.raises(ValueError, match="values="):
        estimate(values)
    with pytest.raises(ValueError, match="y="):
        difference([1.0], values)


def test_the_worst_mean_is_of_a_tenth_of_the_episodes_rounded_up() -> None:
    costs = np.random.default_rng(0).permutation(np.arange(40.0))
    assert worst_mean(costs) == np.mean([39, 38, 37, 36])
    assert worst_mean(costs[costs < 11]) == np.mean([10, 9])
    assert worst_mean([3.0]) == 3.0
    with pytest.raises(ValueError, match="costs"):
        worst_mean([])
