"""Distance of the hand from unseen targets under learned inverse kinematics."""

from __future__ import annotations

from functools import cache
from typing import Any, Final

import numpy as np

from saver_envs.modelling.chain import FloatArray
from saver_envs.modelling.kinematics import REFINEMENT, LearnedInverseKinematics
from saver_envs.modelling.workspace import WorkspaceSamples, workspace_samples

TARGETS: Final = 5000
#: Seed of the unseen targets; training uses small seeds.
UNSEEN_SEED: Final = 1000


@cache
def unseen_targets(robot: str) -> WorkspaceSamples:
    """Return targets (5000, target_size) that no model is trained on, with joints for them."""
    return workspace_samples(robot, TARGETS, UNSEEN_SEED)


def accuracy(robot: str, name: str, model: Any) -> dict[str, Any]:
    """Measure the distance of the hand from unseen targets.

    :param robot: the arm's name.
    :param name: of the model, for the result.
    :param model: a fitted inverse kinematics model of the workspace.
    :return: JSON-able; ``millimetres`` has median, 99th percentile and mean, raw and refined.
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
        ("as_used", REFINEMENT, True),
    ):
        learned = LearnedInverseKinematics(robot, model, steps, nearest)
        errors[label] = distances(learned.solve(unseen.targets, present).error)
    return {"robot": robot, "model": name, "targets": TARGETS, "millimetres": errors}


def distances(metres: FloatArray) -> dict[str, float]:
    """Return median, 99th percentile and mean of distances (n,), in millimetres."""
    return {
        "median": float(np.median(metres) * 1e3),
        "p99": float(np.percentile(metres, 99) * 1e3),
        "mean": float(metres.mean() * 1e3),
    }
