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
from saver_advisors.advising.mapping import ArmMapping
from saver_advisors.advising.networks import NetworkSpec, PolicyNetworks
from saver_advisors.advising.random_advising import RandomAdvising
from saver_advisors.advising.registry import STRATEGIES, make_strategy, register_strategy
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
    EarlyAdvising,
    EarlyThenCorrecting,
    MistakeCorrectingAction,
    MistakeCorrectingQ,
    MistakeCorrectingRelativeAction,
    NoAdvice,
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
    "BetterOfBoth",
    "Compare",
    "EarlyAdvising",
    "EarlyThenCorrecting",
    "JumpStart",
    "MistakeCorrectingAction",
    "MistakeCorrectingQ",
    "MistakeCorrectingRelativeAction",
    "NetworkSpec",
    "NoAdvice",
    "PlansAhead",
    "PolicyNetworks",
    "RandomAdvising",
    "Remembers",
    "RunPlan",
    "StudentValues",
    "Teacher",
    "TeacherGroup",
    "TeacherProposals",
    "WatchesStudent",
    "build_advised",
    "make_advisor",
    "make_strategy",
    "networks_from_sb3",
    "register_strategy",
    "start_as_teachers",
]
