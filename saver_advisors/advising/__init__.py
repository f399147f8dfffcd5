"""Budgeted action advising: single-arm teachers help an n-arm student (dissertation, chapter 5)."""

from saver_advisors.advising.advisor import Advice, Advisor, Compare
from saver_advisors.advising.budget import AdviceBudget
from saver_advisors.advising.context import (
    AdviceContext,
    AdvisingStrategy,
    PlansAhead,
    Remembers,
    RunPlan,
    StudentValues,
    WatchesStudent,
)
from saver_advisors.advising.factory import make_advisor
from saver_advisors.advising.ibrl import BetterOfBoth, TeacherProposals
from saver_advisors.advising.initialisation import start_as_teachers
from saver_advisors.advising.jump_start import JumpStart
from saver_advisors.advising.random_advising import RandomAdvising
from saver_advisors.advising.registry import STRATEGIES, make_strategy, register_strategy
from saver_advisors.advising.sb3_seam import (
    AdvisedDDPG,
    AdvisedMixin,
    AdvisedSAC,
    AdvisedTD3,
    AdvisedTQC,
    AdvisingCallback,
    build_advised,
)
from saver_advisors.advising.strategies import (
    EarlyAdvising,
    EarlyThenCorrecting,
    MistakeCorrectingAction,
    MistakeCorrectingQ,
    MistakeCorrectingRelativeAction,
    NoAdvice,
)

__all__ = [
    "STRATEGIES",
    "Advice",
    "AdviceBudget",
    "AdviceContext",
    "AdvisedDDPG",
    "AdvisedMixin",
    "AdvisedSAC",
    "AdvisedTD3",
    "AdvisedTQC",
    "Advisor",
    "AdvisingCallback",
    "AdvisingStrategy",
    "BetterOfBoth",
    "Compare",
    "EarlyAdvising",
    "EarlyThenCorrecting",
    "JumpStart",
    "MistakeCorrectingAction",
    "MistakeCorrectingQ",
    "MistakeCorrectingRelativeAction",
    "NoAdvice",
    "PlansAhead",
    "RandomAdvising",
    "Remembers",
    "RunPlan",
    "StudentValues",
    "TeacherProposals",
    "WatchesStudent",
    "build_advised",
    "make_advisor",
    "make_strategy",
    "register_strategy",
    "start_as_teachers",
]
