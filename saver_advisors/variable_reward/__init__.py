"""Three-stage variable-reward learning under a safety constraint (dissertation, chapter 6)."""

from saver_advisors.variable_reward.control import StageControl, StagesCallback
from saver_advisors.variable_reward.replay import ConstraintReplayBuffer
from saver_advisors.variable_reward.stages import SwitchRule, TrainingStage

__all__ = [
    "ConstraintReplayBuffer",
    "StageControl",
    "StagesCallback",
    "SwitchRule",
    "TrainingStage",
]
