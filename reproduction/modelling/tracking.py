"""Measure the tracking error of the twins with each feed-forward and with feedback alone."""

from __future__ import annotations

import argparse
from itertools import product
from typing import Any, Final

import numpy as np

from reproduction.modelling.model_arguments import (
    ROBOTS,
    Models,
    add_arms_and_models,
    measure_models,
    origin,
)
from reproduction.page_templates import page
from saver_advisors.cli.arguments import add_page
from saver_advisors.cli.model import prepare_data
from saver_advisors.reporting.tables import Column
from saver_envs.modelling.chain import FloatArray
from saver_envs.modelling.datasets import campaign_of, samples_of
from saver_envs.modelling.dynamics import LearnedInverseDynamics, tracking_error
from saver_envs.modelling.models import new_model
from saver_envs.modelling.trajectories import random_trajectory
from saver_envs.modelling.twin import Twin

EXAMPLES: Final = """\
examples:
  python -m reproduction tracking --json tracking.json
  python -m reproduction tracking --robots mico --models cgan lsgan identified --epochs 30
  python -m reproduction tracking --weights mico-id.safetensors --robots mico"""

MODELS: Final = ("mlp", "cgan", "lsgan", "bigan", "dualgan", "identified")
FEEDBACK, ANALYTIC, SHIPPED = UNTRAINED = ("feedback alone", "analytic", "shipped")
"""Feed-forwards that need no training."""
GAINS: Final = (1.0, 0.25)
_UNSEEN: Final = 1000
"""Seed of the way-points; data sets have small seeds."""

_WAY_POINTS: Final = 12
_TRAJECTORIES: Final = 4


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_arms_and_models(parser, ROBOTS, MODELS, "models to train on the whole data set")
    add_page(parser)


def run(args: argparse.Namespace) -> int:
    """Measure, print the page, and write the requested files.

    :param args: see :func:`add_arguments`.
    :return: exit status.
    :raises UsageError: for weight files or a device that cannot be used.
    """

    def samples(robot: str) -> tuple[FloatArray, FloatArray]:
        return samples_of(prepare_data(robot).train, "id")

    return measure_models(args, "tracking", "id", UNTRAINED, samples, measure, render)


def measure(args: argparse.Namespace, models: Models) -> dict[str, Any]:
    """Measure the tracking error of every arm and feed-forward.

    :param args: see :func:`add_arguments`.
    :param models: trained models and those of weight files.
    :return: JSON-able; ``rows`` has one row per arm, feed-forward and gain.
    """
    rows = []
    for robot in args.robots:
        generator = np.random.default_rng(_UNSEEN)
        interval = campaign_of(robot).interval
        ways = [
            random_trajectory(robot, _WAY_POINTS, interval, generator) for _ in range(_TRAJECTORIES)
        ]
        twin = Twin(robot)
        # The shipped model is the default of learned dynamics.
        several = {ANALYTIC: new_model("analytic", robot, "id"), SHIPPED: None, **models[robot]}
        feed_forwards: dict[str, Any] = {FEEDBACK: None}
        feed_forwards |= {name: LearnedInverseDynamics(robot, one) for name, one in several.items()}
        for (name, feed_forward), gain in product(feed_forwards.items(), GAINS):
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
    return {"title": "Tracking on the twins", "kind": "tracking", "rows": rows}


def render(figures: dict[str, Any]) -> str:
    """Render the figures as a page.

    :param figures: what was measured, or the content of its JSON file.
    :return: Markdown.
    """
    rows = figures["rows"]
    base = {
        (one["robot"], one["gain"]): one["rms"] for one in rows if one["feed_forward"] == "analytic"
    }
    columns: dict[str, Column] = {
        "arm": "{robot}",
        "gain": "{gain:g}",
        "feed-forward": "{feed_forward}",
        "RMS (mrad)": lambda one: f"{one['rms'] * 1e3:.2f}",
        "analytic's error over it": lambda one: (
            f"{base[one['robot'], one['gain']] / one['rms']:.2f}x"
        ),
        "per joint": lambda one: " ".join(f"{joint * 1e3:.2f}" for joint in one["per_joint"]),
    }
    before = {card["name"] for card in figures.get("weights", [])}
    trained = {one["feed_forward"] for one in rows} & set(MODELS) - before
    ordered = sorted(rows, key=lambda one: (one["robot"], -one["gain"]))
    content = {**figures, "rows": ordered, "trained": trained, "origin": origin(figures)}
    return page("tracking", columns=columns, **content)
