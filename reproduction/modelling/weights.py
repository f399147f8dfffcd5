"""Models that were trained before a measurement: their files, and how they came about."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from reproduction.modelling.cells import Task

if TYPE_CHECKING:
    from saver_envs.modelling.models import InverseModel


def add_weights(parser: argparse.ArgumentParser) -> None:
    """Declare files of models that were trained before and are measured too.

    :param parser: a command's that measures models in use
    """
    parser.add_argument(
        "--weights",
        nargs="*",
        type=Path,
        default=[],
        metavar="FILE",
        help="models that were trained before, named after their files; each is measured with its "
        "own arm",
    )


def trained_before(
    paths: Sequence[Path], robots: Sequence[str], task: Task, taken: Sequence[str]
) -> dict[str, dict[str, InverseModel]]:
    """Read weight files.

    :param paths: of a command with :func:`add_weights`
    :param robots: arms that are measured
    :param task: that all of them must be for
    :param taken: names that other models are shown under
    :return: the models of each arm, by their files' names without ending
    :raises UsageError: for a file that is cut short or not ours, of another task, of an arm that
        is not measured, or with a name that another model of its arm has
    """
    from saver_advisors.reporting.errors import UsageError, user_mistakes
    from saver_envs.modelling.models import load_model

    found: dict[str, dict[str, InverseModel]] = {robot: {} for robot in robots}
    for path in paths:
        with user_mistakes("argument --weights"):
            model = load_model(path, task=task)
        if model.robot not in found:
            raise UsageError(
                f"argument --weights: {path} is of the arm {model.robot!r}, and --robots asks for "
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
    """What the figures keep of the files: ``weights``, with the card and the name of each.

    :param paths: of a command with :func:`add_weights`
    """
    from saver_envs.modelling.models import read_card

    return {"weights": [{"name": path.stem, **read_card(path)} for path in paths]}


def origin(figures: Mapping[str, Any]) -> str:
    """Say how the models came about that were trained before; empty where no card tells.

    :param figures: with what :func:`cards_of` returns, or without
    """
    by_training: dict[str, list[str]] = {}
    for card in figures.get("weights", []):
        if "training" not in card:
            continue
        how = f"{card['training']['epochs']} epochs of {card['samples']:,} samples"
        names, name = by_training.setdefault(how, []), f"`{card['name']}`"
        if name not in names:  # the same network of another arm
            names.append(name)
    said = [f"{', '.join(names)}: {how}" for how, names in by_training.items()]
    return f" Trained before: {'; '.join(said)}." if said else ""
