"""Stages: their order, when they end, and going on with them."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from saver_advisors.variable_reward.stages import (
    StageClock,
    SwitchRule,
    TrainingStage,
    check_stages,
)

THREE = (
    TrainingStage("teaching", SwitchRule("budget")),
    TrainingStage("stretching", SwitchRule("steps", 100)),
    TrainingStage("exploring"),
)


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        ("budget", SwitchRule("budget")),
        ("steps 250000", SwitchRule("steps", 250_000)),
        ("steps 250_000", SwitchRule("steps", 250_000)),
        ("success 0.5", SwitchRule("success", 0.5)),
    ],
)
def test_rules_are_read(text: str, rule: SwitchRule) -> None:
    assert SwitchRule.parse(text) == rule


@pytest.mark.parametrize(
    "text",
    ["", "steps", "steps 0", "steps -1", "steps 1.5", "steps nan", "success 2", "success 0",
     "budget 5", "never", "steps 5 6", "success nan"],
)  # fmt: skip
def test_other_rules_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match="until="):
        SwitchRule.parse(text)


def test_a_stage_is_read() -> None:
    assert TrainingStage.parse("exploring") == TrainingStage("exploring")
    assert TrainingStage.parse("stretching", "steps 5") == TrainingStage(
        "stretching", SwitchRule("steps", 5)
    )
    with pytest.raises(ValueError, match="stage='resting': must be one of teaching, stretching"):
        TrainingStage.parse("resting")
    with pytest.raises(ValueError, match="until='never'"):
        TrainingStage.parse("teaching", "never")
    with pytest.raises(ValueError, match="only in teaching"):
        TrainingStage.parse("stretching", "budget")


@pytest.mark.parametrize(
    ("stages", "message"),
    [
        ([], "one or more of"),
        (
            [TrainingStage("exploring", SwitchRule("steps", 5)), TrainingStage("teaching")],
            "order is",
        ),
        (
            [TrainingStage("teaching", SwitchRule("budget")), TrainingStage("teaching")],
            "at most once",
        ),
        ([TrainingStage("teaching"), TrainingStage("exploring")], "set when it ends"),
        ([TrainingStage("exploring", SwitchRule("steps", 5))], "is the last"),
    ],
)
def test_orders_that_cannot_be(stages: list[TrainingStage], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        check_stages(stages)


def test_the_three_stages() -> None:
    clock = StageClock(THREE)
    assert clock.stage.name == "teaching"
    assert (clock.stage.advised, clock.stage.constrained) == (True, False)
    assert not clock.update(50, advice_left=1)
    assert clock.update(60, advice_left=0)
    assert clock.stage.name == "stretching"
    assert (clock.stage.advised, clock.stage.constrained) == (False, False)
    assert not clock.update(159), "a stage's steps count from its beginning"
    assert clock.update(160)
    assert clock.stage.name == "exploring"
    assert (clock.stage.advised, clock.stage.constrained) == (False, True)
    assert not clock.update(10**9)
    assert clock.state_dict()["switched_at"] == [60, 160]


def test_success_ends_a_stage_only_by_a_new_evaluation() -> None:
    clock = StageClock(
        [TrainingStage("stretching", SwitchRule("success", 0.5)), TrainingStage("exploring")]
    )
    assert not clock.update(10)
    assert not clock.update(20, success_rate=0.49)
    assert clock.update(30, success_rate=0.5)


@given(st.lists(st.integers(0, 40), min_size=1, max_size=30), st.data())
def test_a_resumed_clock_is_where_the_other_is(gaps: list[int], data: st.DataObject) -> None:
    clock, resumed = StageClock(THREE), StageClock(THREE)
    cut = data.draw(st.integers(0, len(gaps) - 1))
    steps = 0
    for index, gap in enumerate(gaps):
        steps += gap
        clock.update(steps, advice_left=100 - steps)
        if index == cut:
            resumed.load_state_dict(json.loads(json.dumps(clock.state_dict())))
        elif index > cut:
            resumed.update(steps, advice_left=100 - steps)
    assert resumed.state_dict() == clock.state_dict()


def test_a_state_of_other_stages_is_refused() -> None:
    state = StageClock(THREE).state_dict()
    with pytest.raises(ValueError, match="this run has"):
        StageClock([TrainingStage("exploring")]).load_state_dict(state)
