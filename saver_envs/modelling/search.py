"""The search of Table 7.3: layers, width, activation and leak; or of a loop's weight; by Optuna."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from saver_envs.modelling.arms import Task
from saver_envs.modelling.models import LOOPED, InverseModel, Training, new_model
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
    the median of the trials before, at the same epoch, are broken off. Where the estimator comes
    back to what it knows, as it does in a space of so few values, it is given one at random that it
    does not. Any other space is gone through as a grid, to the end, so that its parts can be
    compared.

    :param model: its name
    :param robot: the arm's name
    :param task: "ik" or "id"
    :param samples: inputs and outputs
    :param training: of every trial; its seed is the search's too
    :param trials: how many different settings
    :param space: of architectures, or of settings of the training
    :return: for each trial its ``settings``, ``epochs`` (fewer than the training's where it was
        broken off), least ``validation_rmse`` and ``cpu_seconds``
    """
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    architectures = space is ARCHITECTURES
    done: list[dict[str, Any]] = []
    untried = _all_settings(space)
    left = max(0, len(untried) - trials)
    generator = np.random.default_rng(training.seed)

    def objective(trial: optuna.Trial) -> float:
        settings = _suggested(trial, space)
        if settings not in untried:
            another = untried[generator.integers(len(untried))]
            trial.study.enqueue_trial(_without_dash(another))
            known = next(one for one in done if one["settings"] == settings)
            return float(known["validation_rmse"])
        untried.remove(settings)
        errors: list[float] = []

        def report(epoch: int, error: float) -> None:
            errors.append(error)
            trial.report(error, epoch)
            if architectures and trial.should_prune():
                raise optuna.TrialPruned

        began = time.process_time()
        try:
            fitted, training_now = _as_set(model, robot, task, training, settings, architectures)
            fitted.fit(*samples, training_now, report)
        finally:
            if errors:
                done.append(_outcome(settings, errors, time.process_time() - began))
        return min(errors)

    def stop(study: optuna.Study, _: object) -> None:
        if len(untried) == left:
            study.stop()

    sampler: optuna.samplers.BaseSampler = optuna.samplers.TPESampler(seed=training.seed)
    if not architectures:
        sampler = optuna.samplers.GridSampler(space, seed=training.seed)
    pruner = optuna.pruners.MedianPruner(n_warmup_steps=_WARM_UP_EPOCHS)
    study = optuna.create_study(sampler=sampler, pruner=pruner)
    study.optimize(objective, callbacks=[stop])
    return done


def _as_set(
    model: str,
    robot: str,
    task: Task,
    training: Training,
    settings: Mapping[str, Any],
    architectures: bool,
) -> tuple[InverseModel, Training]:
    """A model and a training with settings of one or the other."""
    if not architectures:
        return new_model(model, robot, task), replace(training, **settings)
    architecture = Architecture(**_without_dash(settings))
    return new_model(model, robot, task, architecture=architecture), training


def _outcome(settings: dict[str, Any], errors: Sequence[float], seconds: float) -> dict[str, Any]:
    return {
        "settings": settings,
        "epochs": len(errors),
        "validation_rmse": min(errors),
        "cpu_seconds": seconds,
    }


def _all_settings(space: Space) -> list[dict[str, Any]]:
    """Every combination, in the form of :func:`_suggested`."""
    every = [dict(zip(space, values, strict=True)) for values in product(*space.values())]
    for settings in every:
        if _leakless(settings):
            settings["leak"] = "-"
    return [one for place, one in enumerate(every) if one not in every[:place]]


def _leakless(settings: Mapping[str, Any]) -> bool:
    return "activation" in settings and settings["activation"] != "leaky_relu"


def _without_dash(settings: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in settings.items() if value != "-"}


def _suggested(trial: Any, space: Space) -> dict[str, Any]:
    """A trial's settings; a leak only where the activation has one."""
    settings: dict[str, Any] = {}
    for name, values in space.items():
        if name == "leak" and _leakless(settings):
            settings[name] = "-"
        else:
            settings[name] = trial.suggest_categorical(name, values)
    return settings
