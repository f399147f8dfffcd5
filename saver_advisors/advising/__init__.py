"""Budgeted action advising: single-arm teachers help an n-arm student (dissertation, chapter 5).

In the order of a step: `advised_algorithms` calls the `advisor`, which passes a `context` to one of
the `strategies`. `warm_start` copies the teachers' weights into the student.
"""

from saver_advisors.advising.advised_algorithms import (
    AdvisedDDPG,
    AdvisedMixin,
    AdvisedSAC,
    AdvisedTD3,
    AdvisedTQC,
    AdvisingCallback,
    build_advised,
)
from saver_advisors.advising.advisor import Advisor, make_advisor, names_code
from saver_advisors.advising.context import AdviceContext
from saver_advisors.advising.strategies import STRATEGIES, make_strategy, register_strategy
from saver_advisors.advising.warm_start import warm_start_from_teachers

__all__ = [
    "STRATEGIES",
    "AdviceContext",
    "AdvisedDDPG",
    "AdvisedMixin",
    "AdvisedSAC",
    "AdvisedTD3",
    "AdvisedTQC",
    "Advisor",
    "AdvisingCallback",
    "build_advised",
    "make_advisor",
    "make_strategy",
    "names_code",
    "register_strategy",
    "warm_start_from_teachers",
]
