from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from saver_advisors.evaluation.metrics import (
    EPOCH_STEPS,
    LearningCurve,
    area_under_curve,
    learning_metrics,
    time_to_level,
)


def curve_of(success, every=EPOCH_STEPS, seconds_each=60.0):
    """An evaluation an epoch, the first after one."""
    number = np.arange(1, len(success) + 1)
    return LearningCurve(every * number, np.array(success), seconds_each * number)


@st.composite
def curves(draw):
    """Success rates of 100 episodes, at rising steps."""
    n = draw(st.integers(1, 12))
    gaps = draw(st.lists(st.integers(1, 50_000), min_size=n, max_size=n))
    hits = draw(hnp.arrays(np.int64, n, elements=st.integers(0, 100)))
    return LearningCurve(np.cumsum(gaps), hits / 100)


def test_the_figures_of_a_curve_by_hand():
    # MSR 0.8; 10% of it, 0.08, is first seen in epoch 3, 90% of it, 0.72, in epoch 6.
    curve = curve_of([0.0, 0.05, 0.1, 0.3, 0.7, 0.75, 0.8, 0.6])
    found = learning_metrics(curve)
    assert found.maximum_success_rate == 0.8
    assert found.inspired_epoch == 3
    assert found.rise_time == 3
    assert found.effective_learning_rate == pytest.approx(0.72 / 6)
    assert found.resolution == 1
    assert time_to_level(curve, 0.7).steps == 5 * EPOCH_STEPS
    assert time_to_level(curve, 0.7).seconds == 300


def test_a_level_counts_when_floats_would_deny_it():
    # 72 of 100 is 90% of 80 of 100, but not in floats.
    assert 0.9 * 0.8 > 0.72
    assert learning_metrics(curve_of([0.1, 0.72, 0.8])).rise_time == 1


def test_what_was_never_reached_is_censored_at_the_last_evaluation():
    late = time_to_level(curve_of([0.1, 0.85, 0.89]))
    assert (late.steps, late.seconds) == (None, None)
    assert (late.observed_steps, late.observed_s) == (3 * EPOCH_STEPS, 180)
    assert time_to_level(curve_of([0.1, 0.9, 0.9])).steps == 2 * EPOCH_STEPS


def test_a_level_must_be_seen_twice_in_a_row():
    assert time_to_level(curve_of([0.9, 0.8, 0.95, 0.9])).steps == 3 * EPOCH_STEPS
    for luck in ([0.1, 0.9], [0.9], [0.9, 0.8, 0.9]):
        assert time_to_level(curve_of(luck)).steps is None
    # Of a run's own maximum, one evaluation is enough.
    assert learning_metrics(curve_of([0.1, 0.9, 0.5])).rise_time == 1


def test_a_run_without_any_success_has_no_epochs():
    flat = learning_metrics(curve_of([0.0, 0.0, 0.0]))
    assert flat.maximum_success_rate == 0
    assert (flat.inspired_epoch, flat.rise_time, flat.effective_learning_rate) == (None,) * 3
    assert flat.solved.steps is None


def test_a_single_evaluation():
    only = learning_metrics(curve_of([0.5], every=2 * EPOCH_STEPS))
    assert (only.inspired_epoch, only.rise_time) == (2, 0)
    assert only.effective_learning_rate == pytest.approx(0.45 / 2)
    before = learning_metrics(LearningCurve(np.array([0.0]), np.array([0.95])))
    assert before.inspired_epoch == 0
    assert before.effective_learning_rate is None


@pytest.mark.parametrize(
    ("steps", "success", "named"),
    [
        ([1, 2], [0.1, math.nan], "success"),
        ([1, math.nan], [0.1, 0.2], "steps"),
        ([1, 2], [0.1, 1.2], "success"),
        ([1, 2], [-0.1, 0.2], "success"),
        ([2, 2], [0.1, 0.2], "steps"),
        ([2, 1], [0.1, 0.2], "steps"),
        ([-1, 1], [0.1, 0.2], "steps"),
        ([1, 2], [0.1], "success"),
        ([], [], "steps"),
    ],
)
def test_curves_that_cannot_be_are_refused(steps, success, named):
    with pytest.raises(ValueError, match=named):
        LearningCurve(np.array(steps, float), np.array(success, float))


def test_points_of_a_run_are_read_as_they_are_written():
    points = [{"steps": 10, "success_rate": 0.5, "wall_clock_s": 1.5}, {"steps": 20}]
    with pytest.raises(ValueError, match="evaluation 1 has no success_rate"):
        LearningCurve.from_points(points)
    points[1]["success_rate"] = 1.0
    assert LearningCurve.from_points(points).seconds is None
    points[1]["wall_clock_s"] = 3.0
    assert LearningCurve.from_points(points).seconds.tolist() == [1.5, 3.0]
    points[0]["processor_s"] = 1.0
    assert LearningCurve.from_points(points).seconds.tolist() == [1.5, 3.0]
    points[1]["processor_s"] = 2.0
    assert LearningCurve.from_points(points).seconds.tolist() == [1.0, 2.0]
    with pytest.raises(ValueError, match="at least one"):
        LearningCurve.from_points([])


@given(curves(), st.sampled_from([0.5, 0.25, 0.125]))
def test_epochs_are_relative_to_the_runs_own_maximum(curve, factor):
    weaker = replace(curve, success=factor * curve.success)
    weak, own = learning_metrics(weaker), learning_metrics(curve)
    assert (weak.inspired_epoch, weak.rise_time) == (own.inspired_epoch, own.rise_time)
    assert area_under_curve(weaker) == pytest.approx(factor * area_under_curve(curve))
    rate = own.effective_learning_rate
    assert weak.effective_learning_rate == (None if rate is None else pytest.approx(factor * rate))


@given(curves(), st.integers(2, 9))
def test_a_slower_run_takes_as_many_times_the_epochs(curve, factor):
    slower = replace(curve, steps=factor * curve.steps)
    fast, slow = learning_metrics(curve), learning_metrics(slower)
    assert area_under_curve(slower) == pytest.approx(area_under_curve(curve))
    if fast.inspired_epoch is not None:
        assert slow.inspired_epoch == pytest.approx(factor * fast.inspired_epoch)
        assert slow.rise_time == pytest.approx(factor * fast.rise_time)
        assert slow.effective_learning_rate == pytest.approx(fast.effective_learning_rate / factor)


@given(curves(), st.integers(1, 100))
def test_a_rising_relabelling_moves_the_level_and_not_the_time(curve, hundredths):
    def relabel(rate):
        return rate**2

    level = hundredths / 100
    bent = replace(curve, success=relabel(curve.success))
    assert time_to_level(bent, relabel(level)).steps == time_to_level(curve, level).steps


@given(curves())
def test_elr_is_the_papers_of_ie_and_rt(curve):
    found = learning_metrics(curve)
    if found.effective_learning_rate is None:
        assert found.maximum_success_rate == 0
    else:
        risen = found.inspired_epoch + found.rise_time
        assert found.effective_learning_rate == pytest.approx(
            0.9 * found.maximum_success_rate / risen
        )
    assert 0 <= area_under_curve(curve) <= found.maximum_success_rate
    later = [time_to_level(curve, level).steps or math.inf for level in (0.1, 0.5, 0.9)]
    assert later == sorted(later)


@given(curves(), st.integers(0, 10**6))
def test_steps_spent_before_the_run_count(curve, spent):
    alone, counted = learning_metrics(curve), learning_metrics(curve, spent_before=spent)
    assert counted.maximum_success_rate == alone.maximum_success_rate
    assert counted.resolution == alone.resolution
    if alone.inspired_epoch is not None:
        assert counted.inspired_epoch == pytest.approx(alone.inspired_epoch + spent / EPOCH_STEPS)
        assert counted.rise_time == pytest.approx(alone.rise_time)


def test_areas_by_hand_and_over_a_common_budget():
    curve = LearningCurve(np.array([100.0, 200.0]), np.array([0.4, 0.8]))
    # Triangles and a trapezium: 0.2 * 100 + 0.6 * 100 over 200 steps.
    assert area_under_curve(curve) == pytest.approx(0.4)
    assert area_under_curve(curve, 100) == pytest.approx(0.2)
    assert area_under_curve(curve, 150) == pytest.approx((20 + 25) / 150)
    # A straight line from 0 before the first evaluation, unless that is at step 0.
    assert area_under_curve(curve_of([0.5])) == pytest.approx(0.25)
    from_start = LearningCurve(np.array([0.0, 100.0]), np.array([0.4, 0.8]))
    assert area_under_curve(from_start) == pytest.approx(0.6)
    for wrong in (0, 201, math.nan):
        with pytest.raises(ValueError, match="up_to"):
            area_under_curve(curve, wrong)


@pytest.mark.parametrize("spent", [-EPOCH_STEPS - 1, math.nan, math.inf])
def test_steps_before_the_run_must_be_a_number(spent):
    with pytest.raises(ValueError, match="steps"):
        learning_metrics(curve_of([0.5]), spent_before=spent)


@pytest.mark.parametrize("level", [0, -0.1, 1.1, math.nan])
def test_a_level_must_be_a_success_rate(level):
    with pytest.raises(ValueError, match="level"):
        time_to_level(curve_of([0.5]), level)
