"""Search for architectures (Table 7.3), or for the weight of a GAN's loop, with Optuna."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any, Final

import numpy as np

from saver_envs.modelling.arms import Task
from saver_envs.modelling.chain import FloatArray
from saver_envs.modelling.models import LOOPED, Training, new_model
from saver_envs.modelling.networks import ACTIVATIONS, MLPArchitecture

_WARM_UP_EPOCHS: Final = 5

#: Names of settings and the values to search.
Space = Mapping[str, Sequence[Any]]
ARCHITECTURES: Final[Space] = {
    "layers": (3, 4, 5, 6, 7, 8),
    "width": (128, 256, 512, 1024),
    "activation": ACTIVATIONS,
    "leak": (0.1, 0.3, 0.4, 0.5, 0.7, 0.9),
}
"""Table 7.3."""


def loop_space(model: str, weights: Sequence[float], trials: int) -> Space | None:
    """Return the space of loop weights, each with the same seeds.

    :param model: name of the model.
    :param weights: weights to search; none for another search.
    :param trials: greatest number of trials.
    :return: ``loop_weight`` and ``seed``, with as many seeds as the trials allow; None without
        weights.
    :raises ValueError: for a model without loops, an invalid weight, or too few trials.
    """
    if not weights:
        return None
    if model not in LOOPED:
        raise ValueError(f"model={model!r} has no loop: choose one of {', '.join(LOOPED)}")
    for weight in weights:
        Training(loop_weight=weight)
    seeds = trials // len(weights)
    if seeds < 1:
        raise ValueError(f"trials={trials}: must be at least one per weight, {len(weights)}")
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

    Architectures are sampled by Optuna's tree-structured Parzen estimator, and a trial stops when
    it is worse than the median of the previous ones at the same epoch. When the estimator repeats
    itself, as it does in so small a space, a random untried setting follows. Other spaces are
    searched as a grid without early stopping, so that their values can be compared.

    :param model: name of the model.
    :param robot: the arm's name.
    :param task: ``ik`` or ``id``.
    :param samples: inputs and outputs.
    :param training: of every trial; the search uses its seed as well.
    :param trials: number of different settings.
    :param space: architectures, or settings of the training.
    :return: for each trial its ``settings``, ``epochs`` (fewer than the training's if it stopped
        early), least ``validation_rmse`` and ``cpu_seconds``.
    """
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    architectures = space is ARCHITECTURES
    done: list[dict[str, Any]] = []
    untried = _all_settings(space)
    left = max(0, len(untried) - trials)
    generator = np.random.default_rng(training.seed)

    def objective(trial: optuna.Trial) -> float:
        settings = _settings(space, trial.suggest_categorical)
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
            if architectures:
                shape = MLPArchitecture(**_without_dash(settings))
                fresh, how = new_model(model, robot, task, architecture=shape), training
            else:
                fresh, how = new_model(model, robot, task), replace(training, **settings)
            fresh.fit(*samples, how, report)
        finally:
            if errors:
                outcome = {"epochs": len(errors), "validation_rmse": min(errors)}
                seconds = time.process_time() - began
                done.append({"settings": settings, **outcome, "cpu_seconds": seconds})
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


def _all_settings(space: Space) -> list[dict[str, Any]]:
    """Return every combination that differs from the others."""
    distinct: list[dict[str, Any]] = []
    for values in product(*space.values()):
        given = dict(zip(space, values, strict=True))
        settings = _settings(space, lambda name, _, given=given: given[name])
        if settings not in distinct:
            distinct.append(settings)
    return distinct


def _without_dash(settings: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in settings.items() if value != "-"}


def _settings(space: Space, choose: Callable[..., Any]) -> dict[str, Any]:
    """Choose a value for every setting; the leak is ``-`` for activations without one."""
    settings: dict[str, Any] = {}
    for name, values in space.items():
        leakless = name == "leak" and settings["activation"] != "leaky_relu"
        settings[name] = "-" if leakless else choose(name, values)
    return settings
