"""Build a run's environment and its learner: networks, replay buffer and advisor."""

from __future__ import annotations

from dataclasses import fields
from functools import partial
from inspect import signature
from typing import Any

from stable_baselines3.common.logger import Logger
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecEnv

from saver_advisors.advising import (
    Advisor,
    build_advised,
    make_advisor,
    names_code,
    warm_start_from_teachers,
)
from saver_advisors.evaluation.protocol import training_seed
from saver_advisors.learner.algorithms import (
    GoalDDPG,
    GoalLearnerMixin,
    GoalSAC,
    GoalTD3,
    GoalTQC,
    attribute_of,
    episode_horizon,
    task_of,
)
from saver_advisors.learner.dagger import GoalDAgger
from saver_advisors.learner.replay import DemonstrationReplayBuffer, GoalReplayBuffer
from saver_advisors.training.settings import RunConfig, naming
from saver_advisors.variable_reward import ConstraintReplayBuffer, StageControl, TrainingStage
from saver_envs.envs.sb3_vec_env import SaverVecEnv
from saver_envs.registration import make_episodes
from saver_envs.validation import require

ALGORITHMS: dict[str, type[OffPolicyAlgorithm]] = {
    "ddpg": GoalDDPG,
    "td3": GoalTD3,
    "sac": GoalSAC,
    "tqc": GoalTQC,
    "dagger": GoalDAgger,
}
#: Arguments of GoalTD3 that the other algorithms do not have; fields of the same names.
TD3_ARGUMENTS = (
    "policy_delay",
    "target_policy_noise",
    "target_noise_clip",
    "imitation_weight",
    "imitation_filter_start",
    "contact_cost",
    "cost_key",
    "cost_limit",
    "multiplier_lr",
)


def build_env(config: RunConfig, threads: int = 1) -> VecEnv:
    """Build the environments that a run trains in.

    :param config: settings of the run.
    :param threads: threads of the simulation.
    :return: a vector env of ``config.n_envs`` environments.
    :raises ValueError: for keyword arguments out of range; it names the setting.
    :raises TypeError: for unknown keyword arguments; it names the setting.
    """
    options = {**config.env_kwargs, **config.train_env_kwargs}
    try:
        seed = training_seed(config.seed)
        return SaverVecEnv(
            config.env_id, n_envs=config.n_envs, seed=seed, threads=threads, **options
        )
    except (ValueError, TypeError):
        # Find out which of the two settings is wrong.
        with naming("env_kwargs"):
            make_episodes(config.env_id, **config.env_kwargs)
        with naming("train_env_kwargs"):
            raise


def build_model(config: RunConfig, env: VecEnv) -> GoalLearnerMixin:
    """Build the untrained learner of a run, with its advisor.

    :param config: settings of the run.
    :param env: the run's vector env.
    :return: the learner.
    :raises ValueError: if teachers, arms, strategy, budget or networks do not fit.
    :raises TypeError: for a teacher without the networks that a setting needs.
    """
    build: Any = ALGORITHMS[config.algorithm]
    advice, horizon = config.advice, episode_horizon(env)
    by_arm = config.per_arm_critics or config.shared_arms
    goal_parts = _goal_parts(env) if by_arm else None
    arguments = _replay_arguments(config, horizon, goal_parts)
    if config.learns_costs:
        _check_cost(config.cost_key, env)
    if config.algorithm == "td3":
        arguments |= {name: getattr(config, name) for name in TD3_ARGUMENTS}
    if advice is not None:
        build = build_advised(build)
        with naming("advice"):
            arguments["advisor"] = build_advisor(config, env)
    model: Any = build(
        "SharedArmsPolicy" if config.shared_arms else "MultiInputPolicy",
        env,
        learning_rate=config.learning_rate,
        buffer_size=config.buffer_size,
        learning_starts=config.learning_starts,
        batch_size=config.batch_size,
        tau=config.tau,
        gamma=config.gamma,
        train_freq=(horizon, "step"),
        gradient_steps=config.gradient_steps,
        policy_kwargs=_policy_arguments(config, goal_parts),
        exploration_noise=config.exploration_noise,
        random_action_probability=config.random_action_probability,
        random_action_steps=config.random_action_steps,
        seed=config.seed,
        device="cpu",
        **arguments,
    )
    # SB3's constructor has seeded the environments with the run's own seed.
    env.seed(training_seed(config.seed))
    model.set_logger(Logger(folder=None, output_formats=[]))
    if advice is not None and advice.warm_start:
        with naming("advice"):
            warm_start_from_teachers(model, model.advisor.teachers, model.advisor.mapping)
    if advice is not None and advice.bootstrap:
        model.bootstrap_proposals = partial(model.advisor.propose, model.policy.scale_action)
    assert isinstance(model, GoalLearnerMixin)
    return model


def build_stages(config: RunConfig, model: OffPolicyAlgorithm) -> StageControl | None:
    """Build the stages of a run's variable reward, and enter the first.

    :param config: settings of the run.
    :param model: its learner.
    :return: None for a run without stages.
    :raises ValueError: for invalid stages, or stages that do not fit environment and advice.
    """
    if config.stages is None:
        return None
    stages = [TrainingStage.parse(one.stage, one.until) for one in config.stages]
    return StageControl(model, stages, constraint_value_weight=config.constraint_value_weight)


def demonstration_steps(config: RunConfig, horizon: int) -> int:
    """Compute the environment steps that teachers demonstrate: whole episodes of all environments.

    :param config: settings of the run.
    :param horizon: steps of an episode.
    :return: steps, 0 or more.
    :raises ValueError: if the budget or the run is too short for them.
    """
    if config.advice is None:
        return 0
    block = horizon * config.n_envs
    steps = -(-config.advice.demonstration_steps // block) * block
    limits = {"advice.budget": config.advice.budget, "total_steps": config.total_steps}
    for name, limit in limits.items():
        if steps > limit:
            raise ValueError(
                f"advice.demonstration_steps={config.advice.demonstration_steps} are {steps} in "
                f"whole episodes of {config.n_envs} environments ({horizon} steps each), but "
                f"{name}={limit}: raise it, or ask for at most {limit // block * block}"
            )
    return steps


def build_advisor(config: RunConfig, env: VecEnv) -> Advisor:
    """Build the advisor of a run and check it against the run's environment.

    :param config: settings of the run, with advice.
    :param env: the run's vector env.
    :return: the advisor, with its whole budget.
    :raises ValueError: if teachers, arms, strategy or budget do not fit.
    """
    advice, horizon = config.advice, episode_horizon(env)
    assert advice is not None
    accepted = signature(make_advisor).parameters
    named = {f.name: getattr(advice, f.name) for f in fields(advice) if f.name in accepted}
    if any(map(names_code, advice.teachers)):
        named["n_arms"] = getattr(task_of(env), "n_arms", None)
    advisor = make_advisor(
        **named,
        episodes=attribute_of(env, "episodes"),
        observation_space=env.observation_space,
        action_space=env.action_space,
        total_steps=config.total_steps,
        horizon=horizon,
        seed=config.seed,
    )
    if demonstration_steps(config, horizon) > 0 and not advisor.advisable.all():
        raise ValueError(
            f"advice.demonstration_steps={advice.demonstration_steps} with "
            f"advice.arms={list(advice.arms or ())}: a demonstration needs a teacher for every "
            "arm; omit advice.arms"
        )
    return advisor


def _replay_arguments(
    config: RunConfig, horizon: int, goal_parts: tuple[int, ...] | None
) -> dict[str, Any]:
    kind: type[GoalReplayBuffer] | None = None
    arguments: dict[str, Any] = {
        "horizon": horizon,
        "relabel_probability": config.relabel_probability,
        "goal_parts": goal_parts,
        "team_rewards": config.team_rewards,
    }
    if config.advice is not None and config.advice.demonstration_steps > 0:
        kind = DemonstrationReplayBuffer
        arguments["demonstration_size"] = demonstration_steps(config, horizon)
        arguments["demonstration_fraction"] = config.advice.demonstration_fraction
    if config.constraint_relabelling is not None:
        if kind is not None:
            raise ValueError(
                f"constraint_relabelling={config.constraint_relabelling!r} with "
                "advice.demonstration_steps above 0: no replay buffer supports both"
            )
        kind = ConstraintReplayBuffer
        arguments["constraint_relabelling"] = config.constraint_relabelling
    return {"replay_buffer_class": kind, "replay_buffer_kwargs": arguments}


def _policy_arguments(config: RunConfig, goal_parts: tuple[int, ...] | None) -> dict[str, Any]:
    arguments: dict[str, Any] = {
        "net_arch": list(config.net_arch),
        "layer_norm": config.layer_norm,
    }
    if config.q_min is not None:
        arguments["q_min"] = config.q_min
    if config.achieved_goal_input:
        arguments["features_extractor_kwargs"] = {"achieved_goal": True}
    if config.algorithm in ("ddpg", "td3"):
        arguments["action_penalty"] = config.action_penalty
    if config.algorithm in ("td3", "dagger"):
        arguments["n_values"] = 1 if goal_parts is None else len(goal_parts)
    return arguments


def _check_cost(key: str, env: VecEnv) -> None:
    """Reject a cost that the environment's task does not have, before the first step."""
    if (task := task_of(env)) is not None:
        costs = ("cost", *(f"cost_{name}" for name in task.costs))
        require("cost_key", key, key in costs, f"one of {', '.join(costs)}")


def _goal_parts(env: VecEnv) -> tuple[int, ...]:
    """Return the sizes of the goal's parts: one per arm, and one that all share, if any."""
    task = task_of(env)
    if task is None:
        raise ValueError(
            "per_arm_critics or shared_arms: the environment must be one of saver_envs"
        )
    layout = task.goal_layout
    return (layout.block,) * layout.n_arms + ((layout.shared,) if layout.shared else ())
