import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from saver_advisors.advising.context import AdviceBudget

steps = st.lists(st.lists(st.booleans(), min_size=1, max_size=9), max_size=20)


@given(st.integers(0, 40), steps)
def test_exactly_the_first_takers_get_it(total, wants):
    budget = AdviceBudget(total)
    left = total
    for wanted in wants:
        expected = []
        for one in wanted:
            expected.append(one and left > 0)
            left -= expected[-1]
        assert budget.spend(np.array(wanted)).tolist() == expected
        assert (budget.spent, budget.remaining) == (total - left, left)


def test_five_remain_and_eight_want():
    budget = AdviceBudget(5)
    assert budget.spend(np.ones(8, bool)).tolist() == [True] * 5 + [False] * 3
    assert budget.remaining == 0


@pytest.mark.parametrize("wrong", [-1, np.int64(-3)])
def test_negative_totals_are_refused(wrong):
    with pytest.raises(ValueError, match="total=-"):
        AdviceBudget(wrong)


@pytest.mark.parametrize("wrong", [1.5, "7", True, None])
def test_totals_must_be_whole_numbers(wrong):
    with pytest.raises(TypeError, match="whole number"):
        AdviceBudget(wrong)


def test_state_survives_json():
    budget = AdviceBudget(10)
    budget.spend(np.ones(4, bool))
    resumed = AdviceBudget(10)
    resumed.load_state_dict(json.loads(json.dumps(budget.state_dict())))
    assert (resumed.spent, resumed.remaining) == (4, 6)
    with pytest.raises(ValueError, match=r"spent=4 exceeds .* 3"):
        AdviceBudget(3).load_state_dict(budget.state_dict())
