"""Arguments that several commands of chapter 7 share, and models that are read from files."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from reproduction.command_parts import add_choices
from reproduction.modelling.grid import PAPER_EPOCHS
from saver_advisors.cli.arguments import add, add_count, add_path
from saver_advisors.cli.measured import measure_and_render
from saver_advisors.reporting.errors import UsageError, user_mistakes
from saver_envs.modelling.arms import Task
from saver_envs.modelling.chain import FloatArray
from saver_envs.modelling.models import InverseModel, Training, load_model, new_model, read_card
from saver_envs.modelling.networks import DEVICES, PRECISIONS

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
    text = "weight files of models to measure, each with its own arm, shown by file name"
    add_path(parser, "--weights", text, nargs="*", default=[])


def add_training(parser: argparse.ArgumentParser) -> None:
    """Declare how networks are trained.

    :param parser: the command's parser.
    """
    add_count(parser, "--epochs", PAPER_EPOCHS, "epochs of training")
    add_precision(parser)
    text = "device that trains the networks; predictions run on the CPU"
    add(parser, "--device", text, "cpu", choices=DEVICES)


def add_precision(parser: argparse.ArgumentParser) -> None:
    """Declare the precision in which networks are trained.

    :param parser: the command's parser.
    """
    text = (
        "precision of the matrix products between hidden layers during training: float32, or "
        "bfloat16, which takes two thirds of the time on processors that support it and much "
        "longer on others"
    )
    add(parser, "--precision", text, "float32", choices=PRECISIONS, metavar="NAME")


def training_of(args: argparse.Namespace) -> dict[str, Any]:
    """Return how models are trained: ``epochs``, ``precision`` and ``device``.

    :param args: of a command with :func:`add_training`.
    :return: keyword arguments of ``Training``.
    :raises UsageError: if ``--device`` names a GPU and there is none.
    """
    with user_mistakes("argument --device"):
        Training(device=args.device)
    return {"epochs": args.epochs, "precision": args.precision, "device": args.device}


Models = Mapping[str, Mapping[str, InverseModel]]
"""Models by arm and name."""


def measure_models(
    args: argparse.Namespace,
    kind: str,
    task: Task,
    taken: Sequence[str],
    samples: Callable[[str], tuple[FloatArray, FloatArray]],
    measure: Callable[[argparse.Namespace, Models], dict[str, Any]],
    render: Callable[[dict[str, Any]], str],
) -> int:
    """Measure models or read figures of them; see `saver_advisors.cli.measured.measure_and_render`.

    :param args: with the arguments of :func:`add_arms_and_models`.
    :param kind: the kind of the figures.
    :param task: task of the models.
    :param taken: names that no weight file may have, besides those of ``--models``.
    :param samples: returns the inputs and outputs that the models of an arm are trained on.
    :param measure: takes the measurements, from the trained models and those of weight files.
    :param render: turns figures into a page.
    :return: exit status.
    :raises UsageError: for weight files or a device that cannot be used.
    """
    training = training_of(args)
    models = trained_before(args.weights, args.robots, task, (*taken, *args.models))

    def figures() -> dict[str, Any]:
        from tqdm import tqdm

        for robot, before in models.items() if args.models else ():
            data, trained = samples(robot), {}
            for name in tqdm(args.models, desc=f"{robot}: training", unit="model"):
                trained[name] = new_model(name, robot, task)
                trained[name].fit(*data, Training(**training))
            models[robot] = {**trained, **before}
        return {**measure(args, models), **training, **cards_of(args.weights)}

    return measure_and_render(args, kind, figures, render)


def trained_before(
    paths: Sequence[Path], robots: Sequence[str], task: Task, taken: Sequence[str]
) -> dict[str, dict[str, InverseModel]]:
    """Read weight files.

    :param paths: the files.
    :param robots: arms that are measured.
    :param task: task that all models must be for.
    :param taken: names of the other models.
    :return: the models of each arm, by their files' names without suffix.
    :raises UsageError: for a file that is damaged or no weight file, of another task, of an arm
        that is not measured, or with a name that another model of its arm has.
    """
    found: dict[str, dict[str, InverseModel]] = {robot: {} for robot in robots}
    for path in paths:
        with user_mistakes("argument --weights"):
            model = load_model(path, task=task)
        if model.robot not in found:
            raise UsageError(
                f"argument --weights: {path} is a model of {model.robot!r}, but --robots selects "
                f"{', '.join(robots)}"
            )
        if path.stem in taken or path.stem in found[model.robot]:
            raise UsageError(
                f"argument --weights: {path}: there is another {path.stem!r} for "
                f"{model.robot!r}; rename the file"
            )
        found[model.robot][path.stem] = model
    return found


def cards_of(paths: Sequence[Path]) -> dict[str, Any]:
    """Read what the figures keep of the files.

    :param paths: the files.
    :return: ``weights``, with the card and the name of each file.
    """
    return {"weights": [{"name": path.stem, **read_card(path)} for path in paths]}


def origin(figures: Mapping[str, Any]) -> str:
    """Say how the models of weight files were trained.

    :param figures: with or without what :func:`cards_of` returns.
    :return: a sentence; empty if no card says so.
    """
    # Mappings as ordered sets: networks of several arms may have the same name.
    by_training: dict[str, dict[str, None]] = {}
    for card in figures.get("weights", []):
        if "training" in card:
            how = f"{card['training']['epochs']} epochs of {card['samples']:,} samples"
            by_training.setdefault(how, {})[f"`{card['name']}`"] = None
    said = [f"{', '.join(names)}: {how}" for how, names in by_training.items()]
    return f" Trained before: {'; '.join(said)}." if said else ""
