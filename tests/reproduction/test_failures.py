"""Causes of failure on trajectories that were made to have them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reproduction.transfer.failures import (
    CAME_UP,
    FIRM,
    PICK_CAUSES,
    PRESSED,
    PUSH_CAUSES,
    RETREAT,
    WORDS,
    Failure,
    find_failure,
)
from reproduction.transfer.trajectories import TrialTrajectory

T, SIZE = 40, 0.056
TARGET = np.array([0.45, 0.0, SIZE / 2])


def path(*points: Any) -> Any:
    """(T + 1, 3) through points (step, x, y, z above the rest height), straight between them."""
    table = np.array(points, float)
    steps = np.arange(T + 1)
    columns = [np.interp(steps, table[:, 0], table[:, column]) for column in (1, 2, 3)]
    return np.stack(columns, axis=1) + np.array([0, 0, SIZE / 2])


def trial(cube: Any, tool: Any = None, **more: Any) -> TrialTrajectory:
    """A trial of one arm; the hand stays far away where no path is given."""
    tool = path((0, 0.2, 0.3, 0.2)) if tool is None else tool
    speed = np.linalg.norm(np.gradient(cube, axis=0), axis=-1) / 0.04
    values: dict[str, Any] = {
        "tool": tool[:, None],
        "object": cube[:, None],
        "object_speed": speed[:, None],
        "target": TARGET[None],
        "closing": np.zeros((T, 1), bool),
        "collided": np.zeros(T, bool),
        "object_size": SIZE,
        "threshold": 0.05,
        "reach": 0.62,
        "success": False,
    }
    return TrialTrajectory(**{**values, **more})


def touching(*steps: int) -> Any:
    """(T,) with contact on these steps."""
    flags = np.zeros(T, bool)
    flags[list(steps)] = True
    return flags


def test_success_has_no_cause() -> None:
    done = trial(path((0, 0.3, 0, 0), (30, 0.45, 0, 0)), success=True)
    assert find_failure("push", done) is None
    assert find_failure("pick", done) is None


# Pushing ------------------------------------------------------------------------------------------


def test_a_cube_that_came_near_and_went_away_slid_away() -> None:
    passed_by = trial(path((0, 0.30, 0.1, 0), (20, 0.45, 0.08, 0), (30, 0.45, 0.2, 0)))
    failure = find_failure("push", passed_by)
    assert failure is not None
    assert failure.cause == "slid_away"
    # It left when it was 1 cm beyond its closest approach of 8 cm.
    assert 20 < failure.step <= 22


def test_a_cube_pushed_the_wrong_way_from_the_start_slid_away() -> None:
    failure = find_failure("push", trial(path((0, 0.30, 0, 0), (10, 0.30, 0, 0), (30, 0.20, 0, 0))))
    assert failure is not None
    assert (failure.cause, failure.step) == ("slid_away", 13)  # 5 mm a step from step 10 on


def test_a_cube_out_of_reach_slid_away_however_near_its_target_is() -> None:
    near_the_rim = {"target": np.array([[0.58, 0.0, SIZE / 2]]), "reach": 0.50}
    failure = find_failure(
        "push", trial(path((0, 0.45, 0.1, 0), (30, 0.56, 0.07, 0)), **near_the_rim)
    )
    assert failure is not None
    assert failure.cause == "slid_away"


@pytest.mark.parametrize(("retreat", "cause"), [(0.8, "inaccurate"), (1.2, "slid_away")])
def test_a_small_retreat_is_none(retreat: float, cause: str) -> None:
    end = 0.45 - 0.04 - retreat * RETREAT
    cube = path((0, 0.30, 0, 0), (20, 0.41, 0, 0), (30, end, 0, 0))
    failure = find_failure("push", replace(trial(cube), threshold=0.05))
    assert failure is not None
    assert failure.cause == cause


def test_resting_close_by_is_inaccurate_and_moving_there_timed_out() -> None:
    rests = path((0, 0.30, 0, 0), (30, 0.38, 0, 0))
    assert find_failure("push", trial(rests)) == Failure("inaccurate", T, 0)
    still_moving = path((0, 0.30, 0, 0), (30, 0.30, 0, 0), (T, 0.38, 0, 0))
    assert find_failure("push", trial(still_moving)) == Failure("timed_out", T, 0)


def test_an_untouched_cube_timed_out() -> None:
    assert find_failure("push", trial(path((0, 0.30, 0, 0)))) == Failure("timed_out", T, 0)


def test_pressing_is_a_collision_and_brushing_is_none() -> None:
    cube = path((0, 0.30, 0, 0))
    pressed = trial(cube, collided=touching(*range(7, 7 + PRESSED)))
    assert find_failure("push", pressed) == Failure("collided", 7, 0)
    brushed = trial(cube, collided=touching(7, 8, 10, 11))
    assert find_failure("push", brushed) == Failure("timed_out", T, 0)


@pytest.mark.parametrize(("step", "cause"), [(5, "collided"), (30, "slid_away")])
def test_the_first_event_is_the_cause(step: int, cause: str) -> None:
    cube = path((0, 0.30, 0.1, 0), (15, 0.45, 0.08, 0), (25, 0.45, 0.2, 0))
    failure = find_failure("push", trial(cube, collided=touching(*range(step, step + 5))))
    assert failure is not None
    assert failure.cause == cause


def test_only_arms_that_failed_count() -> None:
    """Arm 0 overshoots and comes back to its target; arm 1 rests short of it."""
    there_and_back = path((0, 0.45, 0, 0), (20, 0.45, 0.2, 0), (35, 0.45, 0.01, 0))
    short = path((0, 0.30, 0, 0), (30, 0.38, 0, 0))
    one, other = trial(there_and_back), trial(short)
    both = replace(
        one,
        **{
            name: np.concatenate([getattr(one, name), getattr(other, name)], axis=1)
            for name in ("tool", "object", "object_speed", "closing")
        },
        target=np.concatenate([one.target, other.target]),
    )
    assert find_failure("push", both) == Failure("inaccurate", T, 1)


def test_a_simulation_that_broke_down_is_no_policys_fault() -> None:
    broken = trial(path((0, 0.3, 0, 0)), collided=touching(*range(9)), diverged=True)
    for failure in (find_failure("push", broken), find_failure("pick", broken)):
        assert failure is not None
        assert failure.cause == "diverged"


# Pick and place -----------------------------------------------------------------------------------


def carried(*cube: Any, tool: Any, closed_from: int = 5) -> TrialTrajectory:
    """A trial with a hand that closes."""
    closing = np.zeros((T, 1), bool)
    closing[closed_from:] = True
    return trial(path(*cube), path(*tool), closing=closing)


LIFT = ((0, 0.3, 0, 0), (8, 0.3, 0, 0), (18, 0.3, 0, 0.10))


def test_a_cube_that_falls_from_the_hand_is_a_lost_grasp() -> None:
    cube = (*LIFT, (22, 0.3, 0, 0.10), (25, 0.3, 0, 0))
    failure = find_failure(
        "pick", carried(*cube, tool=(*LIFT, (22, 0.3, 0, 0.10), (34, 0.4, 0, 0.12)))
    )
    assert failure is not None
    assert failure.cause == "grasp_lost"
    assert 22 < failure.step <= 25


def test_a_cube_that_slips_within_the_hand_is_a_lost_grasp() -> None:
    """It hangs on, 4 cm below where it was, but is not where the policy knows it to be."""
    cube = (*LIFT, (20, 0.3, 0, 0.10), (26, 0.3, 0, 0.06), (40, 0.3, 0, 0.015))
    failure = find_failure("pick", carried(*cube, tool=(*LIFT, (40, 0.3, 0, 0.11))))
    assert failure is not None
    assert failure.cause == "grasp_lost"


def test_a_cube_that_is_set_down_is_not_lost() -> None:
    """Lowered to the table 8 cm from its target, left there, and the hand goes up again."""
    down = (*LIFT, (26, 0.37, 0, 0), (32, 0.37, 0, 0))
    failure = find_failure("pick", carried(*down, tool=(*down, (T, 0.37, 0, 0.2))))
    assert failure == Failure("inaccurate", T, 0)


def test_a_cube_that_is_caught_again_is_not_lost() -> None:
    fallen = (*LIFT, (20, 0.3, 0, 0.10), (22, 0.3, 0, 0))
    again = (*fallen, (28, 0.3, 0, 0), (36, 0.38, 0, 0.10))
    hand = (*LIFT, (24, 0.3, 0, 0.10), (28, 0.3, 0, 0), (36, 0.38, 0, 0.10))
    failure = find_failure("pick", carried(*again, tool=hand))
    assert failure == Failure("timed_out", T, 0)


def test_a_hand_that_comes_up_empty_had_a_weak_grasp() -> None:
    hand = ((0, 0.3, 0, 0.1), (5, 0.3, 0, 0), (12, 0.3, 0, 0), (22, 0.3, 0, 2.5 * CAME_UP))
    failure = find_failure("pick", carried((0, 0.3, 0, 0), tool=hand, closed_from=6))
    assert failure is not None
    assert failure.cause == "weak_grasp"
    assert 12 < failure.step <= 17


def test_an_open_hand_that_passes_by_has_no_grasp_to_lose() -> None:
    hand = ((0, 0.3, 0, 0.1), (5, 0.3, 0, 0), (12, 0.3, 0, 0), (22, 0.3, 0, 0.1))
    failure = find_failure("pick", carried((0, 0.3, 0, 0), tool=hand, closed_from=T))
    assert failure == Failure("timed_out", T, 0)


def test_held_beside_the_target_at_the_end_is_inaccurate() -> None:
    """8 cm beside a target in the air."""
    up = (*LIFT, (30, 0.37, 0, 0.10))
    shown = replace(carried(*up, tool=up), target=TARGET[None] + [0, 0, 0.10])
    assert find_failure("pick", shown) == Failure("inaccurate", T, 0)


@settings(deadline=None, max_examples=60)
@given(seed=st.integers(0, 10**6), arms=st.integers(1, 3))
def test_every_failure_has_one_known_cause_within_the_trial(seed: int, arms: int) -> None:
    """Whatever happened; and a longer wait before the same trial changes no cause."""
    random = np.random.default_rng(seed)

    def wander(scale: float) -> Any:
        moved = random.normal(scale=scale, size=(T + 1, arms, 3)).cumsum(axis=0)
        return np.array([0.4, 0, 0.05]) + moved

    cube = wander(0.01)
    cube[..., 2] = np.maximum(cube[..., 2], SIZE / 2)
    made = TrialTrajectory(
        tool=cube + wander(0.005) - [0.4, 0, 0.05],
        object=cube,
        object_speed=random.uniform(0, 0.2, (T + 1, arms)),
        target=np.tile(TARGET, (arms, 1)) + random.normal(scale=0.2, size=(arms, 3)),
        closing=random.random((T, arms)) < 0.7,
        collided=random.random(T) < 0.3,
        object_size=SIZE,
        threshold=0.05,
        reach=0.62,
        success=False,
    )
    for failure, causes in (
        (find_failure("push", made), PUSH_CAUSES),
        (find_failure("pick", made), PICK_CAUSES),
    ):
        assert failure is not None
        assert failure.cause in causes
        assert 0 <= failure.step <= T
        assert 0 <= failure.arm < arms
    assert set(WORDS) == {*PUSH_CAUSES, *PICK_CAUSES}
    assert FIRM >= 1
