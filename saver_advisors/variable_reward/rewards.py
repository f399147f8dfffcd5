"""The reward of a training stage, as a pure function of goals."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from stable_baselines3.common.vec_env import VecEnv

from saver_advisors.learner.replay import RewardFunction
from saver_advisors.variable_reward.stages import TrainingStage


def task_of(env: VecEnv) -> Any:
    """Return the task of a vector environment, an immutable dataclass.

    :param env: our vector env, or SB3's vector env of our goal envs.
    :return: the task, None for a third-party environment.
    """
    try:
        return env.get_attr("episodes", indices=[0])[0].task
    except AttributeError:
        return None


def reward_of(stage: TrainingStage, task: Any) -> RewardFunction:
    """Return the reward function of a stage.

    This function holds all that the package knows about tasks: the field ``reward_stage``.

    :param stage: the current stage.
    :param task: of the environment; it defines how goal and constraint combine.
    :return: a function of achieved and desired goals, (batch, goal_dim) each; it holds no
        environment.
    :raises ValueError: if the task's reward has no such stage.
    """
    name = "constrained" if stage.constrained else "goal"
    try:
        reward: RewardFunction = replace(task, reward_stage=name).reward
    except (TypeError, ValueError) as error:
        kind = "none of this package's" if task is None else task.name
        raise ValueError(
            f"stages need a task with a constraint, whose reward has the stage {name!r}; this "
            f"environment's is {kind}"
        ) from error
    return reward
