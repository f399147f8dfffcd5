"""Learned inverse kinematics in use: how exact, how fast, and whether a policy still succeeds.

Four questions: how far the hand stays from unseen targets, raw and behind the refinement; how long
a prediction takes; what a call costs beside damped least squares; and the success of a policy when
set-points become joints through each model instead of through damped least squares.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from statistics import median
from typing import TYPE_CHECKING, Any, Final

from saver_advisors.benchmark.machine import median_ratio, timed
from saver_advisors.cli.measured import hand_over, measured_or_read
from saver_envs.modelling.accuracy import TARGETS, accuracy, unseen_targets

if TYPE_CHECKING:
    from saver_envs.modelling.models import InverseModel

EXAMPLES: Final = """\
examples:
  python -m reproduction kinematics --json kinematics.json --table kinematics.md
  python -m reproduction kinematics --models cgan lsgan bigan dualgan    raw networks as well
  python -m reproduction kinematics --robots jaco --weights flow.safetensors
  python -m reproduction kinematics --robots jaco --episodes 20"""

ARMS: Final = ("mico", "jaco", "fetch")
ENVS: Final = {"jaco": "JacoPush-v0", "mico": "MicoPush-v0"}
POLICIES: Final = {"jaco": ("jaco-push",), "mico": ("jaco-push", "expert")}
"""The MICO is driven by the Jaco's policy, which it was not trained for, and by a scripted one."""
NETWORKS: Final = ("mlp", "cgan", "lsgan", "bigan", "dualgan", "conditional", "flow")
SQUARES: Final = "damped least squares"
SHIPPED: Final = "shipped"

_N_ENVS: Final = (16, 64, 256)
_ROUNDS: Final = 60
_STEPS: Final = 2
"""Refinement of the shipped models, Newton steps."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    from reproduction.modelling.arguments import add_arms_and_models
    from reproduction.modelling.weights import add_weights
    from saver_advisors.cli.arguments import add_page, at_least

    purpose = "models that are trained here, on the workspace's targets, and used raw"
    add_arms_and_models(parser, ARMS, NETWORKS, purpose)
    add_weights(parser)
    parser.add_argument(
        "--samples",
        type=at_least(100),
        default=60_000,
        metavar="N",
        help="to train those on (default: 60000)",
    )
    parser.add_argument(
        "--episodes", type=at_least(1), default=100, metavar="N", help="(default: 100)"
    )
    add_page(parser)


def run(args: argparse.Namespace) -> int:
    """Measure, show, and write where asked for.

    :param args: see :func:`add_arguments`
    :return: exit status
    """
    from reproduction.modelling.arguments import training_of
    from reproduction.modelling.kinematics_page import render
    from reproduction.modelling.weights import cards_of, trained_before
    from saver_advisors.training.threads import one_thread_of_algebra

    training = training_of(args)
    before = trained_before(args.weights, args.robots, "ik", (SHIPPED, *args.models))
    with one_thread_of_algebra():
        figures = measured_or_read(
            args,
            "kinematics",
            lambda: (
                measure(args.robots, args.models, before, args.samples, training, args.episodes)
                | cards_of(args.weights)
            ),
        )
    hand_over(render(figures), figures, args.json, args.table)
    return 0


def measure(
    robots: Sequence[str],
    models: Sequence[str],
    before: Mapping[str, Mapping[str, InverseModel]],
    samples: int,
    training: Mapping[str, Any],
    episodes: int,
) -> dict[str, Any]:
    """Take every measurement.

    :param robots: arms by name
    :param models: to train here, besides the shipped ones
    :param before: models that were trained before, of each arm by name
    :param samples: to train those of here on
    :param training: of them: ``epochs``, ``precision`` and ``device``
    :param episodes: of each evaluation
    :return: JSON-able: ``prediction``, ``cost``, ``accuracy`` and ``success``
    """
    inverses = {
        robot: _inverses(robot, models, samples, training) | dict(before[robot]) for robot in robots
    }
    used = [robot for robot in robots if robot in ENVS]
    # Times first, and within a minute: the machine should be left alone that long.
    cost = [_cost(robot, inverses[robot][SHIPPED], n_envs) for robot in used for n_envs in _N_ENVS]
    predictions = [
        _prediction(robot, name, model)
        for robot in robots
        for name, model in inverses[robot].items()
    ]
    accuracies = [
        accuracy(robot, name, model) for robot in robots for name, model in inverses[robot].items()
    ]
    success = [
        _success(robot, policy, name, model, steps, episodes)
        for robot in used
        for name, model in {SQUARES: None, **inverses[robot]}.items()
        for steps, policies in _in_use(robot, name)
        for policy in policies
    ]
    return {
        "title": "Learned inverse kinematics in use",
        "kind": "kinematics",
        "samples": samples,
        **training,
        "prediction": predictions,
        "accuracy": accuracies,
        "cost": cost,
        "success": success,
    }


def _in_use(robot: str, name: str) -> list[tuple[int | None, Sequence[str]]]:
    """Newton steps (None: no model), each with the policies that it is measured behind.

    The table's networks are of interest raw, behind the arm's own policy.
    """
    if name == SQUARES:
        return [(None, POLICIES[robot])]
    if name == SHIPPED:
        return [(0, POLICIES[robot]), (_STEPS, POLICIES[robot])]
    return [(0, POLICIES[robot][-1:])]


def _inverses(
    robot: str, names: Sequence[str], samples: int, training: Mapping[str, Any]
) -> dict[str, Any]:
    """The shipped model, and those that are trained here."""
    from tqdm import tqdm

    from saver_envs.modelling.models import Training, new_model
    from saver_envs.modelling.shipped import shipped_model
    from saver_envs.modelling.workspace import workspace_samples

    found: dict[str, Any] = {SHIPPED: shipped_model(robot)}
    if names:
        data = workspace_samples(robot, samples, 0)
        for name in tqdm(names, desc=f"{robot}: training", unit="model"):
            found[name] = new_model(name, robot, "ik")
            found[name].fit(data.targets, data.joints, Training(**training))
    return found


def _prediction(robot: str, name: str, model: Any) -> dict[str, Any]:
    """How long a model alone takes: for one target, and for each of many."""
    from reproduction.modelling.cells import prediction_speed

    unseen = unseen_targets(robot)
    present = unseen.joints if model.needs_present else None

    def predict(rows: slice) -> object:
        return model.predict(unseen.targets[rows], None if present is None else present[rows])

    return {"robot": robot, "model": name, **prediction_speed(predict, TARGETS)}


def _cost(robot: str, model: Any, n_envs: int) -> dict[str, Any]:
    """A call of the refined model beside one of damped least squares, and beside a step.

    On the states and set-points of random actions, each call once and after a step, as in use: what
    is called twice in a row finds everything in the processor's caches.
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
        # In turns, for the first call after a step pays for what the second finds in the caches.
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
    robot: str, policy: str, name: str, model: Any, steps: int | None, episodes: int
) -> dict[str, Any]:
    from saver_advisors.cli.policies import resolve
    from saver_advisors.evaluation.episodes import evaluate_policy
    from saver_envs.modelling.kinematics import LearnedInverseKinematics

    env_id = ENVS[robot]
    kwargs: dict[str, Any] = {}
    if model is not None and steps is not None:
        kwargs["inverse_kinematics"] = LearnedInverseKinematics(robot, model, steps)
    outcomes = evaluate_policy(
        resolve(policy, env_id, {}).predict, env_id, episodes=episodes, env_kwargs=kwargs
    )
    low, high = outcomes.confidence_interval
    return {
        "env": env_id,
        "policy": policy,
        "inverse_kinematics": name,
        "refinement": steps,
        "episodes": episodes,
        "success": outcomes.success_rate,
        "interval": [low, high],
    }
