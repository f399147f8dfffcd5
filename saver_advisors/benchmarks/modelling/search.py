"""The search of Table 7.3: layers, width, activation and leak; or of a loop's weight; by Optuna."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from saver_advisors.benchmarks.modelling.cells import Task
from saver_envs.modelling.models import LOOPED, Training, new_model
from saver_envs.modelling.networks import (
    ACTIVATIONS,
    LAYERS,
    LEAKS,
    WIDTHS,
    Architecture,
)

FloatArray = NDArray[np.float64]

_WARM_UP_EPOCHS: Final = 5

#: What is searched: names of settings and their values.
Space = Mapping[str, Sequence[Any]]
ARCHITECTURES: Final[Space] = {
    "layers": LAYERS,
    "width": WIDTHS,
    "activation": ACTIVATIONS,
    "leak": LEAKS,
}
"""Table 7.3."""


def loop_space(model: str, weights: Sequence[float], trials: int) -> Space | None:
    """Weights of the loop, each with the same seeds.

    :param model: its name
    :param weights: to try; none for another search
    :param trials: how many there may be
    :return: ``loop_weight`` and ``seed``, as many of the latter as there are trials for; None where
        no weights are given
    :raises ValueError: for a model without loops, a weight that cannot be, or too few trials
    """
    if not weights:
        return None
    if model not in LOOPED:
        raise ValueError(f"model={model!r} has no loop: choose one of {', '.join(LOOPED)}")
    for weight in weights:
        Training(loop_weight=weight)
    seeds = trials // len(weights)
    if seeds < 1:
        raise ValueError(f"trials={trials}: must be at least one a weight, {len(weights)}")
    return {"loop_weight": list(weights), "seed": list(range(seeds))}


def search(
    model: str,
    robot: str,
    task: Task,
    samples: tuple[FloatArray, FloatArray],
    training: Training,
    trials: int,
    space: Space = ARCHITECTURES,
) -> list[dict[str, Any]]:
    """Search for the settings with the least validation error.

    Architectures are sought by Optuna's tree-structured Parzen estimator; those that are worse than
    the median of the trials before, at the same epoch, are broken off. Any other space is gone
    through as a grid, to the end, so that its parts can be compared.

    :param model: its name
    :param robot: the arm's name
    :param task: "ik" or "id"
    :param samples: inputs and outputs
    :param training: of every trial; its seed is the search's too
    :param trials: how many
    :param space: of architectures, or of settings of the training
    :return: for each trial that was not broken off its ``settings``, ``validation_rmse`` and
        ``cpu_seconds``
    """
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    architectures = space is ARCHITECTURES
    done: list[dict[str, Any]] = []

    def objective(trial: optuna.Trial) -> float:
        settings = _suggested(trial, space)
        options: dict[str, Any] = {}
        training_now = training
        if architectures:
            options["architecture"] = Architecture(**_without_dash(settings))
        else:
            training_now = replace(training, **settings)

        def report(epoch: int, error: float) -> None:
            trial.report(error, epoch)
            if architectures and trial.should_prune():
                raise optuna.TrialPruned

        began = time.process_time()
        fitted = new_model(model, robot, task, **options)
        error = min(fitted.fit(*samples, training_now, report).validation_rmse)
        seconds = time.process_time() - began
        done.append({"settings": settings, "validation_rmse": error, "cpu_seconds": seconds})
        return error

    sampler: optuna.samplers.BaseSampler = optuna.samplers.TPESampler(seed=training.seed)
    if not architectures:
        sampler = optuna.samplers.GridSampler(space, seed=training.seed)
    study = optuna.create_study(
        sampler=sampler, pruner=optuna.pruners.MedianPruner(n_warmup_steps=_WARM_UP_EPOCHS)
    )
    study.optimize(objective, n_trials=trials)
    return done


def _without_dash(settings: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in settings.items() if value != "-"}


def _suggested(trial: Any, space: Space) -> dict[str, Any]:
    """A trial's settings; a leak only where the activation has one."""
    settings: dict[str, Any] = {}
    for name, values in space.items():
        if name == "leak" and settings["activation"] != "leaky_relu":
            settings[name] = "-"
        else:
            settings[name] = trial.suggest_categorical(name, values)
    return settings
