"""Inverse models, and the table that names them (needs the extra ``modelling``)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch

from saver_envs.modelling.arms import Task
from saver_envs.modelling.models.adversarial import Bigan, Cgan, Dualgan, Lsgan
from saver_envs.modelling.models.analytic import Analytic
from saver_envs.modelling.models.base import KIND
from saver_envs.modelling.models.base import InverseModel as InverseModel
from saver_envs.modelling.models.base import Training as Training
from saver_envs.modelling.models.flow import Flow
from saver_envs.modelling.models.identified import Identified
from saver_envs.modelling.models.mlp import Conditional, Mlp
from saver_envs.modelling.models.network_model import NetworkModel, Standardiser
from saver_envs.modelling.networks import MLPArchitecture
from saver_envs.weights import Header, Shapes, read_header, read_weights

MODELS: Mapping[str, type[InverseModel]] = {
    model.name: model
    for model in (Mlp, Cgan, Lsgan, Bigan, Dualgan, Analytic, Conditional, Flow, Identified)
}
ADVERSARIAL = ("cgan", "lsgan", "bigan", "dualgan")
LOOPED = ("bigan", "dualgan")


def new_model(name: str, robot: str, task: Task, **options: Any) -> InverseModel:
    """Return a fresh model.

    :param name: of ``MODELS``.
    :param robot: the arm's name.
    :param task: ``ik`` or ``id``.
    :param options: of the model, such as ``architecture``.
    :raises ValueError: for an unknown name, or a task that the model does not solve.
    """
    if name not in MODELS:
        raise ValueError(f"model={name!r}: must be one of {', '.join(MODELS)}")
    return MODELS[name](robot, task, **options)


def load_model(path: Path, robot: str | None = None, task: Task | None = None) -> InverseModel:
    """Read a weight file; nothing is unpickled.

    :param path: the file.
    :param robot: the arm that it must be of, or None for any.
    :param task: the task that it must be for, or None for any.
    :raises ValueError: if the file is damaged, inconsistent, or of another kind, arm or task; the
        message says which.
    """
    header = read_header(path, KIND)
    for name, wanted in (("robot", robot), ("task", task)):
        if wanted is not None and header.get(name) != wanted:
            raise ValueError(f"{path} is of {name} {header.get(name)!r}, not {wanted!r}")
    header, tensors = read_weights(path, KIND, _shapes)
    try:
        task = cast(Task, header["task"])  # the model checks it
        model = MODELS[header["model"]](header["robot"], task)
        model._restore(tensors, json.loads(header["settings"]))
        return model
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise ValueError(f"{path} contradicts itself: {error}") from error


def read_card(path: Path) -> dict[str, Any]:
    """Return the card of a weight file: where the model comes from.

    :raises ValueError: for a file that is damaged or of another kind.
    """
    return dict(json.loads(read_header(path, KIND)["card"]))


def _shapes(header: Header) -> Shapes | None:
    """Return the tensors that a file must hold; None for models without networks."""
    model = MODELS[header["model"]]
    if not issubclass(model, NetworkModel):
        return None
    architecture = MLPArchitecture(**json.loads(header["settings"])["architecture"])
    with torch.device("meta"):
        made = model(header["robot"], cast(Task, header["task"]), architecture)
        made._device = torch.device("meta")
        made._weights = made._predictor().state_dict()
    made._input_scale, made._output_scale = (
        Standardiser(np.empty(size), np.empty(size))
        for size in (made.network_input_size, made.output_size)
    )
    return made._state()[0]
