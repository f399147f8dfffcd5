"""The reward of a stage, as a pure function of goals."""

from __future__ import annotations

from dataclasses import replace

from stable_baselines3.common.vec_env import VecEnv

from saver_advisors.learner.replay import RewardFunction
from saver_advisors.variable_reward.stages import Stage
from saver_envs.tasks.distance import Distance


def constrained_task(env: VecEnv) -> Distance:
    """The constrained task of a vector env.

    :param env: of a distance task, our own or SB3's vector env of our goal envs
    :raises ValueError: where its task has no constraint
    """
    try:
        task = env.get_attr("episodes", indices=[0])[0].task
    except AttributeError:
        task = None
    if not isinstance(task, Distance):
        kind = "none of this package's" if task is None else task.name
        raise ValueError(
            f"stages need a task with a constraint (DualJacoDistance-v0), this environment's is "
            f"{kind}"
        )
    return task


def reward_of(stage: Stage, task: Distance) -> RewardFunction:
    """What a transition is worth in a stage.

    :param stage: in force
    :param task: of the environment; how goal and constraint are put together is its own
    :return: a function of (batch, goal) achieved after the action and (batch, goal) desired; it
        holds no environment
    """
    return replace(task, reward_stage="constrained" if stage.constrained else "goal").reward
