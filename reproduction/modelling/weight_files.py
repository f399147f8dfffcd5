"""Read weight files of further models to measure."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from saver_envs.modelling.arms import Task
    from saver_envs.modelling.models import InverseModel


def add_weights(parser: argparse.ArgumentParser) -> None:
    """Declare weight files of models to measure.

    :param parser: the command's parser.
    """
    parser.add_argument(
        "--weights",
        nargs="*",
        type=Path,
        default=[],
        metavar="FILE",
        help="weight files of models to measure, each with its own arm, shown by file name",
    )


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
    from saver_advisors.reporting.errors import UsageError, user_mistakes
    from saver_envs.modelling.models import load_model

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
    from saver_envs.modelling.models import read_card

    return {"weights": [{"name": path.stem, **read_card(path)} for path in paths]}


def origin(figures: Mapping[str, Any]) -> str:
    """Say how the models of weight files were trained.

    :param figures: with or without what :func:`cards_of` returns.
    :return: a sentence; empty if no card says so.
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
