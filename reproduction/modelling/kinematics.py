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
from typing import TYPE_CHECKING, Any, Final

from reproduction.command_parts import measure_and_render
from saver_advisors.benchmark.machine import median_ratio, timed
from saver_advisors.cli.arguments import add_count
from saver_envs.modelling.accuracy import accuracy, unseen_targets

if TYPE_CHECKING:
    from saver_envs.modelling.models import InverseModel

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
    from reproduction.modelling.model_arguments import add_arms_and_models
    from reproduction.modelling.weight_files import add_weights
    from saver_advisors.cli.arguments import add_page

    add_arms_and_models(
        parser, ARMS, NETWORKS, "networks to train on targets of the workspace and to use raw"
    )
    add_weights(parser)
    add_count(parser, "--samples", 60_000, "training samples of these networks", least=100)
    add_count(parser, "--episodes", 100, "episodes of each evaluation")
    add_page(parser)


def run(args: argparse.Namespace) -> int:
    """Measure, print the page, and write the requested files.

    :param args: see :func:`add_arguments`.
    :return: exit status.
    :raises UsageError: for weight files or a device that cannot be used.
    """
    from reproduction.modelling.kinematics_page import render
    from reproduction.modelling.model_arguments import training_of
    from reproduction.modelling.weight_files import cards_of, trained_before

    training = training_of(args)
    before = trained_before(args.weights, args.robots, "ik", (SHIPPED, SHIPPED_GAN, *args.models))

    def figures() -> dict[str, Any]:
        found = measure(args.robots, args.models, before, args.samples, training, args.episodes)
        return found | cards_of(args.weights)

    return measure_and_render(args, "kinematics", figures, render)


def measure(
    robots: Sequence[str],
    models: Sequence[str],
    before: Mapping[str, Mapping[str, InverseModel]],
    samples: int,
    training: Mapping[str, Any],
    episodes: int,
) -> dict[str, Any]:
    """Take every measurement.

    :param robots: names of the arms.
    :param models: models to train, besides the shipped ones.
    :param before: models of weight files, by arm and name.
    :param samples: number of samples to train on.
    :param training: ``epochs``, ``precision`` and ``device`` of the training.
    :param episodes: number of episodes of each evaluation.
    :return: JSON-able: ``prediction``, ``cost``, ``accuracy`` and ``success``.
    """
    inverses = {
        robot: _inverses(robot, models, samples, training) | dict(before[robot]) for robot in robots
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
        "samples": samples,
        **training,
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


def _inverses(
    robot: str, names: Sequence[str], samples: int, training: Mapping[str, Any]
) -> dict[str, Any]:
    """Load the shipped models, and train the others."""
    from tqdm import tqdm

    from saver_envs.modelling.models import Training, new_model
    from saver_envs.modelling.shipped import shipped_model
    from saver_envs.modelling.workspace import workspace_samples

    found: dict[str, Any] = {
        SHIPPED: shipped_model(robot),
        SHIPPED_GAN: shipped_model(robot, adversarial=True),
    }
    if names:
        data = workspace_samples(robot, samples, 0)
        for name in tqdm(names, desc=f"{robot}: training", unit="model"):
            found[name] = new_model(name, robot, "ik")
            found[name].fit(data.targets, data.joints, Training(**training))
    return found


def _prediction(robot: str, name: str, model: Any) -> dict[str, Any]:
    """Time a model alone, for one target and for each of many."""
    from reproduction.modelling.grid_cells import prediction_speed

    unseen = unseen_targets(robot)
    present = unseen.joints if model.needs_present else None
    return {"robot": robot, "model": name, **prediction_speed(model, unseen.targets, present)}


def _cost(robot: str, model: Any, n_envs: int) -> dict[str, Any]:
    """Time a call of the refined model, of damped least squares, and of a step.

    The states and set-points are those of random actions. Each call runs once after a step, as in
    use: a second call in a row would find its data in the processor's caches.
    """
    import numpy as np

    from saver_envs.control import DampedLeastSquares
    from saver_envs.modelling.kinematics import LearnedInverseKinematics
    from saver_envs.registration import make_episodes

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
    """Evaluate a policy whose set-points a model turns into joint targets."""
    from saver_advisors.cli.policies import resolve
    from saver_advisors.evaluation.episodes import evaluate_policy
    from saver_envs.modelling.kinematics import LearnedInverseKinematics

    env_id = ENVS[robot]
    predict = resolve(policy, env_id, {})
    if wrapper:
        outcomes = _through_wrapper(env_id, predict, model, steps, episodes)
    else:
        kwargs = {}
        if model is not None and steps is not None:
            kwargs["inverse_kinematics"] = LearnedInverseKinematics(robot, model, steps)
        outcomes = evaluate_policy(predict, env_id, episodes=episodes, env_kwargs=kwargs)
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


def _through_wrapper(env_id: str, predict: Any, model: Any, steps: Any, episodes: int) -> Any:
    """Evaluate a Cartesian policy on an environment in joint control, through the wrapper."""
    import gymnasium

    from saver_advisors.evaluation.episodes import SingleEpisodeEnv, run_episodes
    from saver_envs.wrappers.learned_ik import LearnedIKAction

    joints: Any = gymnasium.make(f"saver_envs:{env_id}", control="joints")
    with LearnedIKAction(joints, model, steps) as env:
        task = joints.unwrapped.episodes.task
        single = SingleEpisodeEnv(env)
        return run_episodes(predict, single, task, env_id=env_id, episodes=episodes)
