"""Declare the arguments that several commands of chapter 7 share."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from reproduction.command_parts import add_choices
from reproduction.modelling.grid_cells import DEVICES, PAPER_EPOCHS, PRECISIONS
from saver_advisors.cli.arguments import add_count

ROBOTS: Final = ("mico", "fetch")


def add_arms_and_models(
    parser: argparse.ArgumentParser, arms: Sequence[str], models: Sequence[str], purpose: str
) -> None:
    """Declare which arms are measured, and which models are trained for them or read from files.

    :param parser: the command's parser.
    :param arms: arms that can be measured.
    :param models: models that can be trained.
    :param purpose: what those models are for, for the help.
    """
    add_choices(parser, "--robots", arms, "arms")
    add_choices(parser, "--models", models, purpose, (), "*")
    add_training(parser)
    parser.add_argument(
        "--weights",
        nargs="*",
        type=Path,
        default=[],
        metavar="FILE",
        help="weight files of models to measure, each with its own arm, shown by file name",
    )


def add_training(parser: argparse.ArgumentParser) -> None:
    """Declare how networks are trained.

    :param parser: the command's parser.
    """
    add_count(parser, "--epochs", PAPER_EPOCHS, "epochs of training")
    add_precision(parser)
    parser.add_argument(
        "--device",
        choices=DEVICES,
        default="cpu",
        help="device that trains the networks; predictions run on the CPU (default: cpu)",
    )


def add_precision(parser: argparse.ArgumentParser) -> None:
    """Declare the precision in which networks are trained.

    :param parser: the command's parser.
    """
    parser.add_argument(
        "--precision",
        choices=PRECISIONS,
        default="float32",
        metavar="NAME",
        help="precision of the matrix products between hidden layers during training: float32, or "
        "bfloat16, which takes two thirds of the time on processors that support it and much "
        "longer on others (default: float32)",
    )


def training_of(args: argparse.Namespace) -> dict[str, Any]:
    """Return how models are trained: ``epochs``, ``precision`` and ``device``.

    :param args: of a command with :func:`add_training`.
    :return: keyword arguments of ``Training``.
    :raises UsageError: if ``--device`` names a GPU and there is none.
    """
    from saver_advisors.reporting.errors import user_mistakes
    from saver_envs.modelling.models import Training

    with user_mistakes("argument --device"):
        Training(device=args.device)
    return {"epochs": args.epochs, "precision": args.precision, "device": args.device}
