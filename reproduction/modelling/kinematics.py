"""Measure learned inverse kinematics in use: accuracy, prediction time, and success of a policy.

The command measures the distance of the hand from unseen targets, with and without refinement; the
time of a prediction; the time of a call, compared with damped least squares; and the success of a
policy whose set-points each model turns into joint targets. Models replace damped least squares
either in the environment or in the wrapper `LearnedIKAction`, around joint control.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from statistics import median
from typing import Any, Final

import numpy as np

from reproduction.modelling.grid import prediction_speed
from reproduction.modelling.model_arguments import (
    Models,
    add_arms_and_models,
    measure_models,
    origin,
)
from reproduction.page_templates import page
from saver_advisors.benchmark.machine import median_ratio, timed
from saver_advisors.cli.arguments import add_count, add_page
from saver_advisors.reporting.tables import Column
from saver_envs.modelling.accuracy import accuracy, unseen_targets
from saver_envs.modelling.chain import FloatArray
from saver_envs.modelling.kinematics import LearnedInverseKinematics
from saver_envs.modelling.shipped import shipped_model
from saver_envs.modelling.workspace import workspace_samples
from saver_envs.registration import make_episodes, task_and_settings

EXAMPLES: Final = """\
examples:
  python -m reproduction kinematics --json kinematics.json --table kinematics.md
  python -m reproduction kinematics --models cgan lsgan bigan dualgan    also raw networks
  python -m reproduction kinematics --robots jaco --weights flow.safetensors
  python -m reproduction kinematics --robots jaco --episodes 20"""

ARMS: Final = ("mico", "jaco", "fetch")
ENVS: Final = {"jaco": "JacoPush-v0", "mico": "MicoPush-v0"}
POLICIES: Final = {"jaco": ("jaco-push",), "mico": ("jaco-push", "expert")}
"""The MICO runs the Jaco's policy, which was not trained for it, and a scripted policy."""
WRAPPED: Final = ("jaco", "jaco-push")
"""Arm and policy of the episodes through the wrapper."""
NETWORKS: Final = ("mlp", "cgan", "lsgan", "bigan", "dualgan", "conditional", "flow")
SQUARES: Final = "damped least squares"
SHIPPED, SHIPPED_GAN = "shipped", "shipped GAN"

_N_ENVS: Final = (16, 64, 256)
_ROUNDS: Final = 60
_STEPS: Final = 2
"""Newton steps that refine the shipped models."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_arms_and_models(
        parser, ARMS, NETWORKS, "networks to train on targets of the workspace and to use raw"
    )
    add_count(parser, "--samples", 60_000, "training samples of these networks", least=100)
    add_count(parser, "--episodes", 100, "episodes of each evaluation")
    add_page(parser)


def run(args: argparse.Namespace) -> int:
    """Measure, print the page, and write the requested files.

    :param args: see :func:`add_arguments`.
    :return: exit status.
    :raises UsageError: for weight files or a device that cannot be used.
    """

    def samples(robot: str) -> tuple[FloatArray, FloatArray]:
        data = workspace_samples(robot, args.samples, 0)
        return data.targets, data.joints

    taken = (SHIPPED, SHIPPED_GAN)
    return measure_models(args, "kinematics", "ik", taken, samples, measure, render)


def measure(args: argparse.Namespace, models: Models) -> dict[str, Any]:
    """Take every measurement.

    :param args: see :func:`add_arguments`.
    :param models: trained models and those of weight files.
    :return: JSON-able: ``prediction``, ``cost``, ``accuracy`` and ``success``.
    """
    robots, episodes = args.robots, args.episodes
    inverses = {
        robot: {
            SHIPPED: shipped_model(robot),
            SHIPPED_GAN: shipped_model(robot, adversarial=True),
            **models[robot],
        }
        for robot in robots
    }
    used = [robot for robot in robots if robot in ENVS]
    # Times first: the machine should be idle while they are measured, less than a minute.
    cost = [_cost(robot, inverses[robot][SHIPPED], n_envs) for robot in used for n_envs in _N_ENVS]
    every = [(robot, *named) for robot in robots for named in inverses[robot].items()]
    predictions = [_prediction(*one) for one in every]
    accuracies = [accuracy(*one) for one in every]
    success = [
        _success(robot, policy, name, model, steps, episodes)
        for robot in used
        for name, model in {SQUARES: None, **inverses[robot]}.items()
        for steps, policies in _in_use(robot, name)
        for policy in policies
    ]
    wrapped = [
        _success(*WRAPPED, name, inverses[WRAPPED[0]][name], steps, episodes, wrapper=True)
        for name in (SHIPPED, SHIPPED_GAN)
        for steps in (0, _STEPS)
        if WRAPPED[0] in used
    ]
    return {
        "title": "Learned inverse kinematics in use",
        "kind": "kinematics",
        "samples": args.samples,
        "prediction": predictions,
        "accuracy": accuracies,
        "cost": cost,
        "success": success + wrapped,
    }


def _in_use(robot: str, name: str) -> list[tuple[int | None, Sequence[str]]]:
    """List refinements (Newton steps; None: no model), each with the policies it is measured with.

    Networks other than the shipped ones are measured raw, with the arm's own policy.
    """
    if name == SQUARES:
        return [(None, POLICIES[robot])]
    if name in (SHIPPED, SHIPPED_GAN):
        return [(0, POLICIES[robot]), (_STEPS, POLICIES[robot])]
    return [(0, POLICIES[robot][-1:])]


def _prediction(robot: str, name: str, model: Any) -> dict[str, Any]:
    """Time a model alone, for one target and for each of many."""
    unseen = unseen_targets(robot)
    present = unseen.joints if model.needs_present else None
    return {"robot": robot, "model": name, **prediction_speed(model, unseen.targets, present)}


def _cost(robot: str, model: Any, n_envs: int) -> dict[str, Any]:
    """Time a call of the refined model, of damped least squares, and of a step.

    The states and set-points are those of random actions. Each call runs once after a step, as in
    use: a second call in a row would find its data in the processor's caches.
    """
    from saver_envs.control import DampedLeastSquares

    episodes = make_episodes(ENVS[robot], n_envs)
    for index in range(n_envs):
        episodes.set_generator(index, np.random.default_rng(index))
    episodes.reset()
    learned = LearnedInverseKinematics(robot, model, _STEPS)
    squares = DampedLeastSquares(episodes.settings.robot)
    generator = np.random.default_rng(0)
    times: dict[str, list[float]] = {"learned": [], "squares": [], "step": []}
    for turn in range(_ROUNDS + 1):
        actions = generator.uniform(-1, 1, (n_envs, episodes.action_size))
        arms = episodes.simulation.arm_state()
        target = episodes.moved_set_point(generator.uniform(-1, 1, episodes.set_point.shape))
        calls: dict[str, Callable[[], object]] = {
            "learned": partial(learned, arms, target),
            "squares": partial(squares, arms, target),
            "step": partial(episodes.step, actions),
        }
        # Alternate, since the first call after a step fills the caches for the second.
        order = ("learned", "squares", "step") if turn % 2 else ("squares", "learned", "step")
        for name in order:
            taken = timed(calls[name])
            if turn:  # the first turn warms up
                times[name].append(taken)
    return {
        "robot": robot,
        "n_envs": n_envs,
        "learned_us": median(times["learned"]) * 1e6,
        "damped_least_squares_us": median(times["squares"]) * 1e6,
        "ratio": median_ratio(times["learned"], times["squares"]),
        "share_of_step": median_ratio(times["learned"], times["step"]),
    }


def _success(
    robot: str,
    policy: str,
    name: str,
    model: Any,
    steps: int | None,
    episodes: int,
    wrapper: bool = False,
) -> dict[str, Any]:
    """Evaluate a policy whose set-points a model turns into joint targets.

    With ``wrapper`` the environment is in joint control, and the wrapper turns the set-points.
    """
    import gymnasium

    from saver_advisors.cli.policies import resolve
    from saver_advisors.evaluation.episodes import N_ENVS, SingleEpisodeEnv, run_episodes
    from saver_envs.envs.sb3_vec_env import SaverVecEnv
    from saver_envs.wrappers.learned_ik import LearnedIKAction

    env_id = ENVS[robot]
    predict = resolve(policy, env_id, {})
    env: Any
    if wrapper:
        joints = gymnasium.make(f"saver_envs:{env_id}", control="joints")
        env = SingleEpisodeEnv(LearnedIKAction(joints, model, steps or 0))
    else:
        inverse = None if steps is None else LearnedInverseKinematics(robot, model, steps)
        env = SaverVecEnv(env_id, min(episodes, N_ENVS), inverse_kinematics=inverse)
    task = task_and_settings(env_id, {})[0]
    outcomes = run_episodes(predict, env, task, env_id, episodes)
    return {
        "env": env_id,
        "policy": policy,
        "inverse_kinematics": name,
        "used_in": "LearnedIKAction" if wrapper else "environment",
        "refinement": steps,
        "episodes": episodes,
        "success": outcomes.success_rate,
        "interval": list(outcomes.confidence_interval),
    }


ACCURACY: Final = {
    "arm": "{robot}",
    "model": "{model}",
    **{
        label.replace("_", " "): f"{{millimetres[{label}][median]:.3g}} / "
        f"{{millimetres[{label}][p99]:.3g}}"
        for label in ("raw", "one_step", "two_steps", "as_used")
    },
}
PREDICTION: Final = {
    "arm": "{robot}",
    "model": "{model}",
    "one prediction (ms)": "{latency_ms:.3f}",
    "one of 4096 (us)": "{batch_us:.1f}",
}
COST: Final = {
    "arm": "{robot}",
    "n_envs": "{n_envs}",
    "learned (us)": "{learned_us:.0f}",
    "least squares (us)": "{damped_least_squares_us:.0f}",
    "ratio": "{ratio:.2f}x",
    "share of a step": "{share_of_step:.1%}",
}
SUCCESS: Final[Mapping[str, Column]] = {
    "environment": "{env}",
    "policy": "{policy}",
    "inverse kinematics": "{inverse_kinematics}",
    "used in": "{used_in}",
    "Newton steps": lambda one: "-" if one["refinement"] is None else str(one["refinement"]),
    "success": "{success:.3f} [{interval[0]:.3f}, {interval[1]:.3f}]",
}


def render(figures: Mapping[str, Any]) -> str:
    """Render the results as a page.

    :param figures: the measurements, or the content of their JSON file.
    :return: Markdown.
    """
    return page(
        "kinematics",
        of_accuracy=ACCURACY,
        of_prediction=PREDICTION,
        of_cost=COST,
        of_success=SUCCESS,
        origin=origin(figures),
        **figures,
    )
