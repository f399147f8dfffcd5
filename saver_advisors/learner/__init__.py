"""Goal-conditioned learning on SB3: replay with hindsight goals, policies, algorithms."""

from saver_advisors.learner.algorithms import GoalDDPG, GoalSAC, GoalTD3, GoalTQC
from saver_advisors.learner.dagger import GoalDAgger
from saver_advisors.learner.policies import NormalizedGoalFeatures
from saver_advisors.learner.replay import GoalReplayBuffer, reward_function_of

__all__ = [
    "GoalDAgger",
    "GoalDDPG",
    "GoalReplayBuffer",
    "GoalSAC",
    "GoalTD3",
    "GoalTQC",
    "NormalizedGoalFeatures",
    "reward_function_of",
]
