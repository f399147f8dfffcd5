"""Tracking on the twins: joint error with feedback alone, and with each model's feed-forward."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from saver_advisors.cli.measured import hand_over, measured_or_read

if TYPE_CHECKING:
    from saver_envs.modelling.models import InverseModel

EXAMPLES: Final = """\
examples:
  python -m reproduction tracking --json tracking.json
  python -m reproduction tracking --robots mico --models cgan lsgan identified --epochs 30
  python -m reproduction tracking --weights mico-id.safetensors --robots mico"""

MODELS: Final = ("mlp", "cgan", "lsgan", "bigan", "dualgan", "identified")
UNTRAINED: Final = ("feedback alone", "analytic", "shipped")
"""Feed-forwards that are there without training."""
GAINS: Final = (1.0, 0.25)
_UNSEEN: Final = 1000
"""Seed of the way-points: data sets have seed 0 and the like."""

_WAY_POINTS: Final = 12
_TRAJECTORIES: Final = 4


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    from reproduction.modelling.arguments import ROBOTS, add_arms_and_models
    from reproduction.modelling.weights import add_weights
    from saver_advisors.cli.arguments import add_page

    purpose = "trained here on the whole data set, beside the shipped ones"
    add_arms_and_models(parser, ROBOTS, MODELS, purpose)
    add_weights(parser)
    add_page(parser)


def run(args: argparse.Namespace) -> int:
    """Measure, show, and write where asked for.

    :param args: see :func:`add_arguments`
    :return: exit status
    """
    from reproduction.modelling.arguments import training_of
    from reproduction.modelling.weights import cards_of, trained_before
    from saver_advisors.training.threads import one_thread_of_algebra

    training = training_of(args)
    before = trained_before(args.weights, args.robots, "id", (*UNTRAINED, *args.models))
    with one_thread_of_algebra():
        figures = measured_or_read(
            args,
            "tracking",
            lambda: measure(args.robots, args.models, training, before) | cards_of(args.weights),
        )
    hand_over(render(figures), figures, args.json, args.table)
    return 0


def measure(
    robots: Sequence[str],
    models: Sequence[str],
    training: Mapping[str, Any],
    before: Mapping[str, Mapping[str, InverseModel]],
) -> dict[str, Any]:
    """Track with every arm and feed-forward.

    :param robots: arms by name
    :param models: to train here
    :param training: of them: ``epochs``, ``precision`` and ``device``
    :param before: models that were trained before, of each arm by name
    :return: JSON-able; ``rows`` has one of every arm, feed-forward and gain
    """
    rows = [row for robot in robots for row in _rows(robot, models, training, before[robot])]
    return {"title": "Tracking on the twins", "kind": "tracking", **training, "rows": rows}


def _feed_forwards(
    robot: str,
    models: Sequence[str],
    training: Mapping[str, Any],
    before: Mapping[str, InverseModel],
) -> dict[str, Any]:
    """Feed-forwards by name; None is feedback alone."""
    from saver_advisors.cli.model_data import prepare_data
    from saver_envs.modelling.datasets import samples_of, twin_data_set
    from saver_envs.modelling.dynamics import LearnedInverseDynamics
    from saver_envs.modelling.models import Training, new_model

    alone, analytic, shipped = UNTRAINED
    found: dict[str, Any] = {alone: None}
    found[analytic] = LearnedInverseDynamics(robot, new_model("analytic", robot, "id"))
    found[shipped] = LearnedInverseDynamics(robot)
    if models:
        prepare_data(robot)
        samples = samples_of(twin_data_set(robot).train, "id")
        for name in models:
            model = new_model(name, robot, "id")
            model.fit(*samples, Training(**training))
            found[name] = LearnedInverseDynamics(robot, model)
    for name, model in before.items():
        found[name] = LearnedInverseDynamics(robot, model)
    return found


def _rows(
    robot: str,
    models: Sequence[str],
    training: Mapping[str, Any],
    before: Mapping[str, InverseModel],
) -> list[dict[str, Any]]:
    import numpy as np

    from saver_envs.modelling.datasets import campaign_of
    from saver_envs.modelling.dynamics import tracking_error
    from saver_envs.modelling.trajectories import random_trajectory
    from saver_envs.modelling.twin import Twin

    generator = np.random.default_rng(_UNSEEN)
    interval = campaign_of(robot).interval
    ways = [
        random_trajectory(robot, _WAY_POINTS, interval, generator) for _ in range(_TRAJECTORIES)
    ]
    twin = Twin(robot)
    rows = []
    for name, feed_forward in _feed_forwards(robot, models, training, before).items():
        for gain in GAINS:
            error = tracking_error(twin, ways, feed_forward, _UNSEEN, gain)
            rows.append(
                {
                    "robot": robot,
                    "feed_forward": name,
                    "gain": gain,
                    "rms": error.rms,
                    "per_joint": error.per_joint.tolist(),
                }
            )
    return rows


def render(figures: dict[str, Any]) -> str:
    """The figures as a page of Markdown.

    :param figures: what was measured, or its JSON file's content
    """
    from reproduction.modelling.weights import origin
    from saver_advisors.reporting.tables import markdown

    rows = figures["rows"]
    base = {
        (one["robot"], one["gain"]): one["rms"] for one in rows if one["feed_forward"] == "analytic"
    }
    cells = [
        [
            one["robot"],
            f"{one['gain']:g}",
            one["feed_forward"],
            f"{one['rms'] * 1e3:.2f}",
            f"{base[one['robot'], one['gain']] / one['rms']:.2f}x",
            " ".join(f"{value * 1e3:.2f}" for value in one["per_joint"]),
        ]
        for one in sorted(rows, key=lambda one: (one["robot"], -one["gain"]))
    ]
    columns = ["arm", "gain", "feed-forward", "RMS (mrad)", "analytic's error over it", "per joint"]
    before = {card["name"] for card in figures.get("weights", [])}
    trained = {one["feed_forward"] for one in rows} & set(MODELS) - before
    others = f" The others were trained here for {figures.get('epochs', 100)} epochs."
    return (
        f"# {figures['title']}\n\n"
        "Root mean square error of the joints (mrad; mm for the Fetch's lift) on unseen "
        "trajectories. A gain of 1 is the twin's own feedback; less is softer. *Shipped* is the "
        "network that comes along, *analytic* Newton-Euler with the inertia of Appendix A, "
        f"*feedback alone* no feed-forward at all.{others if trained else ''}"
        f"{origin(figures)}\n\n"
        f"{markdown(columns, cells)}"
    )
