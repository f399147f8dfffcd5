"""The search of Table 7.3: layers, width, activation and leak, by Optuna."""

from __future__ import annotations

import time
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from saver_advisors.benchmarks.modelling_cells import Task
from saver_envs.modelling.models import Training, new_model
from saver_envs.modelling.networks import (
    ACTIVATIONS,
    LAYERS,
    LEAKS,
    WIDTHS,
    Activation,
    Architecture,
)

FloatArray = NDArray[np.float64]

_WARM_UP_EPOCHS: Final = 5


def search(
    model: str,
    robot: str,
    task: Task,
    samples: tuple[FloatArray, FloatArray],
    training: Training,
    trials: int,
) -> list[dict[str, Any]]:
    """Search for the architecture with the least validation error.

    Trials that are worse than the median of those before, at the same epoch, are broken off.

    :param model: its name
    :param robot: the arm's name
    :param task: "ik" or "id"
    :param samples: inputs and outputs
    :param training: of every trial; its seed is the search's too
    :param trials: how many
    :return: for each trial that was not broken off its architecture, ``validation_rmse`` and
        ``cpu_seconds``
    """
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    done: list[dict[str, Any]] = []

    def objective(trial: optuna.Trial) -> float:
        activation: Activation = cast(
            Activation, trial.suggest_categorical("activation", ACTIVATIONS)
        )
        leak = trial.suggest_categorical("leak", LEAKS) if activation == "leaky_relu" else LEAKS[0]
        architecture = Architecture(
            layers=trial.suggest_categorical("layers", LAYERS),
            width=trial.suggest_categorical("width", WIDTHS),
            activation=activation,
            leak=leak,
        )

        def report(epoch: int, error: float) -> None:
            trial.report(error, epoch)
            if trial.should_prune():
                raise optuna.TrialPruned

        began = time.process_time()
        fitted = new_model(model, robot, task, architecture=architecture)
        history = fitted.fit(*samples, training, report)
        error = min(history.validation_rmse)
        done.append(
            {
                "layers": architecture.layers,
                "width": architecture.width,
                "activation": activation,
                "leak": leak,
                "validation_rmse": error,
                "cpu_seconds": time.process_time() - began,
            }
        )
        return error

    study = optuna.create_study(
        sampler=optuna.samplers.TPESampler(seed=training.seed),
        pruner=optuna.pruners.MedianPruner(n_warmup_steps=_WARM_UP_EPOCHS),
    )
    study.optimize(objective, n_trials=trials)
    return done
