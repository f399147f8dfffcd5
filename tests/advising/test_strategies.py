import math

import numpy as np
import pytest
from toy_arms import ACTION, GOAL, OBSERVATION, linear_teacher, make_teacher

from saver_advisors.advising import STRATEGIES, AdviceContext, make_strategy
from saver_advisors.advising.context import AdviceBudget
from saver_advisors.advising.strategies import (
    EarlyThenCorrecting,
    MistakeCorrectingAction,
    MistakeCorrectingQ,
    MistakeCorrectingRelativeAction,
)
from saver_advisors.policies.teacher import TeacherGroup


def context(student_actions, *, teacher=None, spent=0, total=100, twin_minimum=True):
    """(n_envs, n_arms, 2) student actions against a teacher that always acts (0.25, 0.25)."""
    student_actions = np.asarray(student_actions, np.float32)
    n_envs, n_arms, _ = student_actions.shape
    group = TeacherGroup(teacher or linear_teacher(), n_arms)
    observations = np.zeros((n_envs, n_arms, OBSERVATION), np.float32)
    goals = np.zeros((n_envs, n_arms, GOAL), np.float32)
    budget = AdviceBudget(total)
    budget.load_state_dict({"total": total, "spent": spent})
    return AdviceContext(
        group,
        observations,
        goals,
        goals,
        group.act(observations, goals),
        student_actions,
        budget,
        np.ones(n_arms, bool),
        twin_minimum,
    )


STUDENT = [[[0.25, 0.25], [0.25, 0.05]], [[-0.25, 0.25], [0.9, 0.9]]]
"""Gaps by the first critic: 0, 0.2, 0.5, -1.3; distances: 0, 0.2, 0.5, 0.919."""


def test_early_and_none():
    assert make_strategy("early").decide(context(STUDENT)).all()
    assert not make_strategy("none").decide(context(STUDENT)).any()


def test_mc_q_compares_the_teachers_values():
    gap = context(STUDENT, twin_minimum=False).q_gap
    np.testing.assert_allclose(gap, [[0, 0.2], [0.5, -1.3]], atol=1e-6)
    mask = MistakeCorrectingQ(0.3).decide(context(STUDENT, twin_minimum=False))
    assert mask.tolist() == [[False, False], [True, False]]
    mask = MistakeCorrectingQ(0.1).decide(context(STUDENT, twin_minimum=False))
    assert mask.tolist() == [[False, True], [True, False]]


def test_twin_minimum_takes_the_smaller_critic():
    # Critic 2 doubles critic 1, so the minimum differs from the first only for negative sums.
    student = [[[-0.5, -0.5]]]
    np.testing.assert_allclose(context(student, twin_minimum=False).q_gap, [[0.5 + 1.0]], atol=1e-6)
    np.testing.assert_allclose(context(student, twin_minimum=True).q_gap, [[0.5 + 2.0]], atol=1e-6)


def test_no_gap_is_no_mistake():
    """The comparison is strict: a student who does what the teacher does is left alone at t = 0."""
    same = context([[[0.25, 0.25]]])
    same = context(same.teacher_actions)
    for strategy in (MistakeCorrectingQ, MistakeCorrectingAction, MistakeCorrectingRelativeAction):
        assert not strategy(0.0).decide(same).any()


def test_mc_act_is_absolute_and_mc_actabs_relative():
    """Equation 5.11: alpha, and alpha * norm2(a_tr); here norm2(a_tr) = 0.3536."""
    assert MistakeCorrectingAction(0.3).decide(context(STUDENT)).tolist() == [
        [False, False],
        [True, True],
    ]
    assert MistakeCorrectingRelativeAction(0.3).decide(context(STUDENT)).tolist() == [
        [False, True],
        [True, True],
    ]
    assert MistakeCorrectingRelativeAction(2.0).decide(context(STUDENT)).tolist() == [
        [False, False],
        [False, True],
    ]


def test_early_mc_hands_over_inside_a_vector():
    strategy = EarlyThenCorrecting(MistakeCorrectingAction(0.1))
    student = np.full((4, 1, ACTION), 0.25)
    student[3] = -1.0
    mask = strategy.decide(context(student, spent=48, total=100))
    assert mask[:, 0].tolist() == [True, True, False, True]
    assert strategy.decide(context(student, spent=0)).all()
    late = strategy.decide(context(student, spent=50))
    assert late[:, 0].tolist() == [False, False, False, True]


def test_early_mc_defaults_to_mc_q():
    assert make_strategy("early-mc") == EarlyThenCorrecting(MistakeCorrectingQ(0.1))
    chosen = make_strategy("early-mc", 0.05, correcting="mc-actabs")
    assert chosen == EarlyThenCorrecting(MistakeCorrectingRelativeAction(0.05))
    assert chosen.settings == {"correcting": "mc-actabs", "threshold": 0.05}


def test_q_values_are_computed_only_when_read():
    lazy = context(STUDENT, teacher=make_teacher(critics=0))
    assert make_strategy("mc-act").decide(lazy).any()
    with pytest.raises(ValueError, match="no critics"):
        MistakeCorrectingQ().decide(lazy)


def test_unknown_names_list_the_valid_ones():
    with pytest.raises(ValueError, match=r"'mcq' .*none, early, mc-q, mc-act, mc-actabs, early-mc"):
        make_strategy("mcq")
    assert all(STRATEGIES[name].name == name for name in STRATEGIES)


@pytest.mark.parametrize("wrong", [-0.1, math.nan, math.inf, "0.1", True])
@pytest.mark.parametrize("name", ["mc-q", "mc-act", "mc-actabs", "early-mc"])
def test_senseless_thresholds_are_refused(name, wrong):
    with pytest.raises((TypeError, ValueError), match="threshold"):
        make_strategy(name, wrong)


def test_arguments_that_a_strategy_has_not():
    with pytest.raises(ValueError, match="'early' takes no threshold"):
        make_strategy("early", 0.1)
    with pytest.raises(ValueError, match="'early-mc' only"):
        make_strategy("mc-q", correcting="mc-act")
    with pytest.raises(ValueError, match="mc-q, mc-act, mc-actabs"):
        make_strategy("early-mc", correcting="early")
