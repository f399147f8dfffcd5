"""Measure pose networks: accuracy on held-out rendered pictures, speed, comparison with BlazePose.

Training and test pictures are rendered; people and patterns of the test are held out.
"""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Callable, Iterable
from functools import partial
from itertools import product
from typing import Any, Final

from saver_advisors.benchmark.machine import progress
from saver_advisors.benchmark.peers.process import PeerError
from saver_advisors.cli import arguments
from saver_advisors.cli.pose import add_weights
from saver_advisors.reporting.errors import UsageError, user_mistakes
from saver_advisors.training.threads import one_thread_of_algebra

EXAMPLES: Final = """\
examples:
  saver benchmark pose                                     the shipped network, every set
  saver benchmark pose --peers --json pose.json            also BlazePose
  saver benchmark pose --weights runs/pose/network.safetensors --frames 100
  saver benchmark pose --only speed                        only the speed"""

FRAMES: Final = 500
HARD_FRAMES: Final = 100
THREADS: Final = (1, 2)
PARTS: Final = ("accuracy", "speed")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_weights(parser)
    text = "test pictures, rounded down to a multiple of 20"
    arguments.add_count(parser, "--frames", FRAMES, text, least=20)
    text = "pictures of each harder set: occluded, low light, two people"
    arguments.add_count(parser, "--hard-frames", HARD_FRAMES, text, least=20)
    arguments.add_count(parser, "--rounds", 7, "rounds of each median")
    arguments.add(
        parser, "--only", "measure only this (default: accuracy and speed)", choices=PARTS
    )
    text = "also BlazePose (lite, full, heavy), in a virtual environment created at first use"
    arguments.add_flag(parser, "--peers", text)
    arguments.add_peer_cache(parser)
    arguments.add_pose_cache(parser)
    arguments.add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Measure, print the tables, and write the figures.

    :param args: see :func:`add_arguments`.
    :return: exit status.
    """
    import pycocotools  # noqa: F401  (needed after the work: say so before it)

    from saver_advisors.benchmark.pose.pose_page import pose_page

    figures: dict[str, Any] = {"kind": "pose", "title": "Seeing a person"}
    try:
        with one_thread_of_algebra():
            if args.only != "speed":
                figures |= _accuracy(args)
            if args.only != "accuracy":
                figures |= _speed(args)
    except (PeerError, OSError) as error:
        raise UsageError(str(error)) from error
    print(pose_page(figures))
    arguments.write_json(args.json, figures)
    return 0


def _accuracy(args: argparse.Namespace) -> dict[str, Any]:
    from saver_advisors.benchmark.pose.accuracy import (
        SETS,
        SHARD,
        accuracy,
        depth_to_centre,
        of_blazepose,
        of_network,
        test_set,
    )
    from saver_advisors.benchmark.pose.blazepose import VARIANTS, BlazePose
    from saver_envs.perception.estimator import PoseEstimator
    from saver_envs.perception.weights import SHIPPED, read_info

    weights = args.weights or SHIPPED
    with user_mistakes("argument --weights"):
        estimator = PoseEstimator.from_file(weights)
    counts = {
        name: (args.frames if name == "test" else args.hard_frames) // SHARD * SHARD
        for name in SETS
    }
    sets = {name: test_set(name, count, args.cache) for name, count in counts.items()}
    estimators = {"saver": estimator}
    with contextlib.suppress(ValueError):  # limbs without their mirror images
        estimators["saver_mirror"] = PoseEstimator(estimator.network, mirror=True)

    def figures(estimates: Callable[..., Any], names: Iterable[str]) -> dict[str, Any]:
        return {one: accuracy(estimates(sets[one], counts[one]), sets[one]) for one in names}

    models = {model: figures(partial(of_network, one), sets) for model, one in estimators.items()}
    for variant in VARIANTS if args.peers else ():
        with BlazePose(variant, args.peer_cache) as peer:
            names = sets if variant == "heavy" else ["test"]
            models[f"blazepose_{variant}"] = figures(partial(of_blazepose, peer), names)
    return {
        "weights": weights.name,
        "weights_info": read_info(weights)["info"],
        "models": models,
        "depth_to_centre": depth_to_centre(test_set("calibration", 5 * SHARD, args.cache)),
    }


def _speed(args: argparse.Namespace) -> dict[str, Any]:
    from saver_advisors.benchmark.pose.speed import LIMB_SETS, SIZES, parsing_rows, speed_row
    from saver_advisors.reporting.provenance import load_averages
    from saver_envs.perception.network import ARCHITECTURES

    before = load_averages()
    rows = []
    cases = list(product(ARCHITECTURES, SIZES, THREADS, LIMB_SETS))
    with progress("speed", len(cases)) as advance:
        for case in cases:
            rounds = args.rounds if case[0] == "light" else max(1, args.rounds // 3)
            rows.append(speed_row(*case, rounds))
            advance()
    return {
        "speed": rows,
        "parsing": parsing_rows(args.rounds),
        "load": {"before": before, "after": load_averages()},
    }
