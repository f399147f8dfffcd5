"""A run's learner, built from its configuration: networks, replay, advisor and what they share."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from gymnasium import spaces
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecEnv

from saver_advisors.learner.algorithms import (
    GoalDDPG,
    GoalSAC,
    GoalTD3,
    GoalTQC,
    episode_horizon,
)
from saver_advisors.learner.demonstrations import DemonstrationReplayBuffer
from saver_advisors.training.settings import AdviceConfig, RunConfig

if TYPE_CHECKING:
    from saver_advisors.advising import Advisor
    from saver_advisors.variable_reward import StageControl

ALGORITHMS: dict[str, type[OffPolicyAlgorithm]] = {
    "ddpg": GoalDDPG,
    "td3": GoalTD3,
    "sac": GoalSAC,
    "tqc": GoalTQC,
}


def build_model(config: RunConfig, env: VecEnv) -> OffPolicyAlgorithm:
    """The untrained learner of a run, with its advisor.

    :param config: of the run
    :param env: the run's vector env
    :return: a goal learner
    :raises ValueError: where teachers, arms, strategy, budget or networks do not fit
    """
    algorithm = ALGORITHMS[config.algorithm]
    build: Callable[..., OffPolicyAlgorithm] = algorithm
    horizon = episode_horizon(env)
    goal_parts = _goal_parts(env) if config.per_arm_critics else None
    replay_arguments: dict[str, Any] = {
        "horizon": horizon,
        "relabel_probability": config.relabel_probability,
        "goal_parts": goal_parts,
    }
    arguments = _td3_arguments(config) if config.algorithm == "td3" else {}
    if config.advice is not None:
        from saver_advisors.advising import build_advised

        build = build_advised(algorithm)
        arguments["advisor"] = build_advisor(
            config, env.observation_space, env.action_space, horizon
        )
        if config.advice.demonstration_steps > 0:
            arguments["replay_buffer_class"] = DemonstrationReplayBuffer
            replay_arguments["demonstration_size"] = demonstration_steps(config, horizon)
            replay_arguments["demonstration_fraction"] = config.advice.demonstration_fraction
    if config.constraint_relabelling is not None:
        _relabel_constraint(config, arguments, replay_arguments)
    model = build(
        "MultiInputPolicy",
        env,
        learning_rate=config.learning_rate,
        buffer_size=config.buffer_size,
        learning_starts=config.learning_starts,
        batch_size=config.batch_size,
        tau=config.tau,
        gamma=config.gamma,
        train_freq=(horizon, "step"),
        gradient_steps=config.gradient_steps,
        replay_buffer_kwargs=replay_arguments,
        policy_kwargs=_policy_arguments(config, goal_parts),
        exploration_noise=config.exploration_noise,
        random_action_probability=config.random_action_probability,
        seed=config.seed,
        device="cpu",
        **arguments,
    )
    model.set_logger(Logger(folder=None, output_formats=[]))
    if config.advice is not None:
        _use_teachers(config.advice, model, arguments["advisor"])
    return model


def _td3_arguments(config: RunConfig) -> dict[str, Any]:
    names = (
        "policy_delay",
        "target_policy_noise",
        "target_noise_clip",
        "imitation_weight",
        "imitation_filter_start",
    )
    return {name: getattr(config, name) for name in names}


def _relabel_constraint(
    config: RunConfig, arguments: dict[str, Any], replay_arguments: dict[str, Any]
) -> None:
    """Ask for the replay that relabels a constraint in its own way."""
    from saver_advisors.variable_reward import ConstraintReplayBuffer

    if "replay_buffer_class" in arguments:
        raise ValueError(
            f"constraint_relabelling={config.constraint_relabelling!r} with "
            "advice.demonstration_steps above 0: there is no replay for both"
        )
    arguments["replay_buffer_class"] = ConstraintReplayBuffer
    replay_arguments["constraint_relabelling"] = config.constraint_relabelling


def build_stages(config: RunConfig, model: OffPolicyAlgorithm) -> StageControl | None:
    """The stages of a run, the first of them in force.

    :param config: of the run
    :param model: its learner
    :return: None where the run has no stages
    :raises ValueError: for stages that cannot be, or that do not fit environment and advice
    """
    if config.stages is None:
        return None
    from saver_advisors.variable_reward import Stage, StageControl

    stages = [Stage.parse(one.stage, one.until) for one in config.stages]
    return StageControl(model, stages, constraint_value_weight=config.constraint_value_weight)


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
    if config.algorithm == "td3":
        arguments["n_values"] = 1 if goal_parts is None else len(goal_parts)
    return arguments


def _use_teachers(advice: AdviceConfig, model: Any, advisor: Advisor) -> None:
    """What teachers do beside advising: lend their weights, and propose actions to the target."""
    from saver_advisors.advising import TeacherProposals, start_as_teachers

    if advice.warm_start:
        start_as_teachers(model, advisor.teachers, advisor.mapping)
    if advice.bootstrap:
        model.proposals = TeacherProposals(advisor, model.policy.scale_action)


def demonstration_steps(config: RunConfig, horizon: int) -> int:
    """Environment steps of a run that the teachers demonstrate: whole episodes of all environments.

    :param config: of the run
    :param horizon: steps of an episode
    :return: steps, 0 or more
    :raises ValueError: where the budget or the run is too short for them
    """
    if config.advice is None:
        return 0
    block = horizon * config.n_envs
    steps = -(-config.advice.demonstration_steps // block) * block
    for name, limit in (
        ("advice.budget", config.advice.budget),
        ("total_steps", config.total_steps),
    ):
        if steps > limit:
            raise ValueError(
                f"advice.demonstration_steps={config.advice.demonstration_steps} are {steps} in "
                f"whole episodes of {config.n_envs} environments ({horizon} steps each), but "
                f"{name}={limit}: raise it, or ask for at most {limit // block * block}"
            )
    return steps


def build_advisor(
    config: RunConfig,
    observation_space: spaces.Space[Any],
    action_space: spaces.Space[Any],
    horizon: int,
) -> Advisor:
    """The advisor of a run, checked against its environment.

    :param config: of the run, with advice
    :param observation_space: of the environment
    :param action_space: of the environment
    :param horizon: steps of an episode
    :return: the advisor, with its whole budget
    :raises ValueError: where teachers, arms, strategy or budget do not fit
    """
    from saver_advisors.advising import make_advisor

    assert config.advice is not None
    steps = demonstration_steps(config, horizon)
    advisor = make_advisor(
        **config.advice.advisor_arguments(),
        observation_space=observation_space,
        action_space=action_space,
        total_steps=config.total_steps,
        horizon=horizon,
        seed=config.seed,
    )
    if steps > 0 and not advisor.advisable.all():
        raise ValueError(
            f"advice.demonstration_steps={config.advice.demonstration_steps} with "
            f"advice.arms={list(config.advice.arms or ())}: in a demonstration every arm has a "
            "teacher; leave advice.arms out"
        )
    return advisor


def _goal_parts(env: VecEnv) -> tuple[int, ...]:
    """Three coordinates an arm; what a task appends, such as a distance, is a part of its own."""
    assert isinstance(env.observation_space, spaces.Dict)
    shape = env.observation_space["desired_goal"].shape
    assert shape is not None
    arms, rest = divmod(shape[0], 3)
    return (3,) * arms + ((rest,) if rest else ())
