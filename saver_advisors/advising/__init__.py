"""Budgeted action advising: single-arm teachers help an n-arm student (dissertation, chapter 5)."""

from saver_advisors.advising.advisor import Advice, Advisor, Compare, make_advisor
from saver_advisors.advising.budget import AdviceBudget
from saver_advisors.advising.mapping import ArmMapping
from saver_advisors.advising.networks import NetworkSpec, PolicyNetworks
from saver_advisors.advising.sb3_networks import networks_from_sb3
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
    STRATEGIES,
    AdviceContext,
    AdvisingStrategy,
    EarlyAdvising,
    EarlyThenCorrecting,
    MistakeCorrectingAction,
    MistakeCorrectingQ,
    MistakeCorrectingRelativeAction,
    NoAdvice,
    make_strategy,
)
from saver_advisors.advising.teacher import Teacher, TeacherGroup

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
    "ArmMapping",
    "Compare",
    "EarlyAdvising",
    "EarlyThenCorrecting",
    "MistakeCorrectingAction",
    "MistakeCorrectingQ",
    "MistakeCorrectingRelativeAction",
    "NetworkSpec",
    "NoAdvice",
    "PolicyNetworks",
    "Teacher",
    "TeacherGroup",
    "build_advised",
    "make_advisor",
    "make_strategy",
    "networks_from_sb3",
]
