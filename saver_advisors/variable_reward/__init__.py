"""Three-stage variable-reward learning under a safety constraint (dissertation, chapter 6)."""

from saver_advisors.variable_reward.control import StageControl, StagesCallback
from saver_advisors.variable_reward.replay import ConstraintReplayBuffer
from saver_advisors.variable_reward.rewards import reward_of, task_of
from saver_advisors.variable_reward.stages import (
    StageClock,
    SwitchRule,
    TrainingStage,
    check_stages,
)

__all__ = [
    "ConstraintReplayBuffer",
    "StageClock",
    "StageControl",
    "StagesCallback",
    "SwitchRule",
    "TrainingStage",
    "check_stages",
    "task_of",
    "reward_of",
]
