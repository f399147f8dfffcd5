"""Goal-conditioned learning on SB3: replay with hindsight goals, policies, algorithms."""

from saver_advisors.learner.algorithms import (
    GoalDDPG,
    GoalLearnerMixin,
    GoalSAC,
    GoalTD3,
    GoalTQC,
    episode_horizon,
    goal_learner,
)
from saver_advisors.learner.imitation import clone
from saver_advisors.learner.policies import (
    GoalPolicyMixin,
    GoalSACPolicy,
    GoalTD3Policy,
    GoalTQCPolicy,
    NormalizedGoalFeatures,
)
from saver_advisors.learner.replay import (
    DemonstrationReplayBuffer,
    GoalReplayBuffer,
    GoalTransitions,
    RewardFunction,
    reward_function_of,
)

__all__ = [
    "DemonstrationReplayBuffer",
    "GoalDDPG",
    "GoalLearnerMixin",
    "GoalPolicyMixin",
    "GoalReplayBuffer",
    "GoalSAC",
    "GoalSACPolicy",
    "GoalTD3",
    "GoalTD3Policy",
    "GoalTQC",
    "GoalTQCPolicy",
    "GoalTransitions",
    "NormalizedGoalFeatures",
    "RewardFunction",
    "clone",
    "episode_horizon",
    "goal_learner",
    "reward_function_of",
]
