"""Three-stage variable-reward learning under a safety constraint (dissertation, chapter 6)."""

from saver_advisors.variable_reward.callback import StagesCallback
from saver_advisors.variable_reward.control import StageControl
from saver_advisors.variable_reward.replay import ConstraintReplayBuffer
from saver_advisors.variable_reward.rewards import constrained_task, reward_of
from saver_advisors.variable_reward.stages import Stage, StageClock, SwitchRule, check_stages

__all__ = [
    "ConstraintReplayBuffer",
    "Stage",
    "StageClock",
    "StageControl",
    "StagesCallback",
    "SwitchRule",
    "check_stages",
    "constrained_task",
    "reward_of",
]
