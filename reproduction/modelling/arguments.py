"""What can be asked of chapter 7's grids on the command line, and of commands beside them."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from reproduction.modelling.cells import (
    DEVICES,
    PAPER_EPOCHS,
    PRECISIONS,
    SIGMAS,
    SIZES,
    Device,
    Task,
)

ROBOTS: Final = ("mico", "fetch")
MODELS: Final[Mapping[Task, tuple[str, ...]]] = {
    "ik": ("mlp", "cgan", "lsgan", "bigan", "dualgan", "analytic", "conditional", "flow"),
    "id": ("mlp", "cgan", "lsgan", "bigan", "dualgan", "analytic", "identified"),
}
RESULTS: Final = Path("runs/modelling")


def declare(parser: argparse.ArgumentParser, task: Task) -> None:
    """Declare the arguments.

    :param parser: the command's
    :param task: "ik" or "id"
    """
    from saver_advisors.cli.arguments import add_page

    parser.add_argument("--robot", choices=ROBOTS, default="mico", help="which arm (default: mico)")
    _add_axes(parser, MODELS[task])
    _add_training(parser)
    _add_kept_results(parser)
    add_page(parser)


def _add_axes(parser: argparse.ArgumentParser, models: Sequence[str]) -> None:
    """Declare what the grid is made of: a cell for each model, size, sigma and seed."""
    from saver_advisors.cli.arguments import at_least

    parser.add_argument(
        "--models",
        nargs="+",
        choices=models,
        default=list(models),
        metavar="NAME",
        help=f"which models (default: {' '.join(models)})",
    )
    parser.add_argument(
        "--sizes",
        nargs="+",
        type=int,
        choices=SIZES,
        default=list(SIZES),
        metavar="K",
        help="the first K x 10,000 samples (default: 1 2 3 4 5 6)",
    )
    parser.add_argument(
        "--sigmas",
        nargs="+",
        type=float,
        choices=SIGMAS,
        default=list(SIGMAS),
        metavar="S",
        help="spread of the fake inputs, adversarial models alone (default: 0 0.2 0.4 0.6)",
    )
    parser.add_argument(
        "--seeds",
        nargs="+",
        type=at_least(0),
        default=[0],
        metavar="N",
        help="of split, weights and noise (default: 0)",
    )
    parser.add_argument(
        "--supervised-weight",
        nargs="+",
        type=_weight,
        default=[0.0],
        metavar="W",
        help="of a squared error in the adversarial losses, which the paper's equations lack; "
        "several are shown apart (default: 0)",
    )


def _add_training(parser: argparse.ArgumentParser) -> None:
    """Declare how a cell's model is trained."""
    from saver_advisors.cli.arguments import at_least

    parser.add_argument(
        "--epochs",
        type=at_least(1),
        default=PAPER_EPOCHS,
        metavar="N",
        help=f"(default: {PAPER_EPOCHS}, the paper's)",
    )
    add_precision(parser)
    add_device(parser)
    parser.add_argument(
        "--processes",
        type=at_least(1),
        default=1,
        metavar="N",
        help="cells trained at once, one core each, and all on the one GPU if on that (default: 1)",
    )


def _add_kept_results(parser: argparse.ArgumentParser) -> None:
    """Declare which results count that were measured earlier."""
    parser.add_argument(
        "--results",
        type=Path,
        default=RESULTS,
        metavar="DIR",
        help=f"where the cells' files are kept (default: {RESULTS})",
    )
    parser.add_argument(
        "--any-hardware",
        action="store_true",
        help="let results count whatever device and precision they were trained in: for a grid "
        "that goes from one machine to another",
    )
    parser.add_argument(
        "--no-training",
        action="store_true",
        help="show the cells that there are, and train none",
    )


def add_arms_and_models(
    parser: argparse.ArgumentParser, arms: Sequence[str], models: Sequence[str], purpose: str
) -> None:
    """Declare which arms, and which models are trained for them while measuring, and how.

    :param parser: a command's that measures models in use
    :param arms: that can be measured
    :param models: that can be trained
    :param purpose: of those, for the help
    """
    from saver_advisors.cli.arguments import at_least

    parser.add_argument(
        "--robots",
        nargs="+",
        choices=arms,
        default=list(arms),
        metavar="ARM",
        help=f"(default: {' '.join(arms)})",
    )
    parser.add_argument(
        "--models",
        nargs="*",
        choices=models,
        default=[],
        metavar="NAME",
        help=f"{purpose} (default: none)",
    )
    parser.add_argument(
        "--epochs",
        type=at_least(1),
        default=PAPER_EPOCHS,
        metavar="N",
        help=f"of those (default: {PAPER_EPOCHS})",
    )
    add_precision(parser)
    add_device(parser)


def add_precision(parser: argparse.ArgumentParser) -> None:
    """Declare in what precision networks are trained.

    :param parser: a command's that trains inverse models
    """
    parser.add_argument(
        "--precision",
        choices=PRECISIONS,
        default="float32",
        metavar="NAME",
        help="of the products between hidden layers while training: float32, or bfloat16, which "
        "takes two thirds of the time where the processor has it, and very long where it has not "
        "(default: float32)",
    )


def add_device(parser: argparse.ArgumentParser) -> None:
    """Declare what networks are trained on.

    :param parser: a command's that trains inverse models
    """
    parser.add_argument(
        "--device",
        choices=DEVICES,
        default="cpu",
        help="what trains the networks; whatever it is, they predict on the CPU (default: cpu)",
    )


def training_of(args: argparse.Namespace) -> dict[str, Any]:
    """How models are trained while measuring: ``epochs``, ``precision`` and ``device``.

    :param args: of a command with :func:`add_arms_and_models`
    :raises UsageError: for a GPU where there is none
    """
    check_device(args.device)
    return {"epochs": args.epochs, "precision": args.precision, "device": args.device}


def check_device(device: Device) -> None:
    """Refuse a GPU where there is none, before anything is made ready for it.

    :param device: as asked for
    :raises UsageError: naming the argument
    """
    from saver_advisors.reporting.errors import user_mistakes
    from saver_envs.modelling.models import Training

    with user_mistakes("argument --device"):
        Training(device=device)


def _weight(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
    if not 0 <= value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text}: must be 0 or more")
    return value
