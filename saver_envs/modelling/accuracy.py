"""How far a learned inverse kinematics leaves the hand from targets that it was not trained on."""

from __future__ import annotations

from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from saver_envs.modelling.kinematics import LearnedInverseKinematics
from saver_envs.modelling.workspace import WorkspaceSamples, workspace_samples

FloatArray = NDArray[np.float64]

TARGETS: Final = 5000
#: Seed of the unseen targets: weights are trained on seed 0 and the like.
UNSEEN_SEED: Final = 1000
#: Newton steps behind the shipped models.
NEWTON_STEPS: Final = 2


@cache
def unseen_targets(robot: str) -> WorkspaceSamples:
    """Targets (5000, target_size) that no model was trained on, with joints that reach them."""
    return workspace_samples(robot, TARGETS, UNSEEN_SEED)


def accuracy(robot: str, name: str, model: Any) -> dict[str, Any]:
    """How far the hand is from unseen targets.

    :param robot: the arm's name
    :param name: what the model is called
    :param model: a fitted inverse kinematics of the workspace
    :return: JSON-able; ``millimetres`` has median, 99th percentile and mean, raw and refined
    """
    unseen = unseen_targets(robot)
    present = None
    if model.needs_present:
        present = np.concatenate([unseen.joints[:1], unseen.joints[:-1]])
    errors = {}
    for label, steps, nearest in (
        ("raw", 0, False),
        ("one_step", 1, False),
        ("two_steps", 2, False),
        ("as_used", NEWTON_STEPS, True),
    ):
        learned = LearnedInverseKinematics(robot, model, steps, nearest)
        errors[label] = distances(learned.solve(unseen.targets, present).error)
    return {"robot": robot, "model": name, "targets": TARGETS, "millimetres": errors}


def distances(metres: FloatArray) -> dict[str, float]:
    """Median, 99th percentile and mean of distances, in millimetres."""
    return {
        "median": float(np.median(metres) * 1e3),
        "p99": float(np.percentile(metres, 99) * 1e3),
        "mean": float(metres.mean() * 1e3),
    }
