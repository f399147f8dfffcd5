"""A learner's state on disk: complete, atomic, and without pickle.

A checkpoint is a folder: ``policy.safetensors`` (networks, targets, normaliser),
``training.safetensors`` (optimizers, the entropy coefficient, torch's generator), ``replay.npz``
and ``state.json`` (counters, the other generators, the caller's values, and checksums of itself and
of the other files). It is written beside the old one and then renamed, so that a crash or a full
disk leaves a complete one.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from pathlib import Path
from textwrap import shorten
from typing import Any

import numpy as np
import torch as th
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.save_util import recursive_getattr

from saver_advisors.learner.algorithms import GoalLearnerMixin
from saver_advisors.reporting.provenance import write_json_atomic
from saver_envs.files import read_json
from saver_envs.weights import read_weights, write_weights

KIND = "saver-checkpoint"
POLICY_FILE = "policy.safetensors"
TRAINING_FILE = "training.safetensors"
REPLAY_FILE = "replay.npz"
STATE_FILE = "state.json"
TORCH_RANDOM = "random/torch"


def save_policy(path: str | Path, policy: th.nn.Module) -> None:
    """Write a policy's networks and buffers as safetensors.

    :param path: of the file; an old one is replaced once the new one is complete.
    :param policy: any module.
    :raises OSError: if it cannot be written.
    """
    # Copies: the networks share the normaliser, and safetensors refuses shared memory.
    state = {name: tensor.detach().cpu().clone() for name, tensor in policy.state_dict().items()}
    write_weights(path, KIND, state, {})


def load_policy(path: str | Path, policy: th.nn.Module) -> None:
    """Load networks and buffers written by ``save_policy``.

    :param path: of the file.
    :param policy: a module of the same shape.
    :raises FileNotFoundError: if there is none.
    :raises ValueError: if the file is damaged or of another shape.
    """
    try:
        policy.load_state_dict(read_tensors(Path(path)))
    except RuntimeError as error:
        difference = shorten(" ".join(str(error).splitlines()[1:]), 160)
        raise ValueError(
            f"{path} does not fit this policy, which needs the same net_arch, layer_norm and "
            f"shared_arms: {difference}"
        ) from error


def save_checkpoint(folder: Path, model: GoalLearnerMixin, extra: dict[str, Any]) -> None:
    """Write the whole state of a run, in place of an older checkpoint.

    :param folder: of the checkpoint.
    :param model: a goal learner.
    :param extra: JSON-able values that ``load_checkpoint`` returns.
    :raises OSError: if it cannot be written; the older checkpoint is then intact.
    """
    partial = folder.with_name(f".{folder.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    try:
        partial.mkdir(parents=True)
        save_policy(partial / POLICY_FILE, model.policy)
        write_weights(partial / TRAINING_FILE, KIND, _training_tensors(model), {})
        model.replay_buffer.save_npz(partial / REPLAY_FILE)
        files = {path.name: _file_checksum(path) for path in sorted(partial.iterdir())}
        # Through JSON, as it is read back: tuples become lists, numbers as keys text.
        state = json.loads(json.dumps({**_counters(model), "extra": extra, "files": files}))
        write_json_atomic(partial / STATE_FILE, {**state, "sha256": _checksum(state)})
        _swap(partial, folder)
    except OSError as error:
        shutil.rmtree(partial, ignore_errors=True)
        reason = getattr(error.__cause__, "strerror", None) or error.strerror or error
        raise OSError(
            error.errno,
            f"the checkpoint {folder} could not be written ({reason}); an earlier one is intact. "
            "Free some disk space, or make the folder writable, and resume",
        ) from error


def find_checkpoint(folder: Path) -> Path | None:
    """Find the checkpoint to resume from.

    :param folder: as passed to ``save_checkpoint``.
    :return: that folder, or the older one if the process ended while it was being replaced; None if
        there is neither.
    """
    candidates = (folder, folder.with_name(f".{folder.name}.previous"))
    return next((one for one in candidates if (one / STATE_FILE).exists()), None)


def load_checkpoint(folder: Path, model: GoalLearnerMixin) -> dict[str, Any]:
    """Restore the state of a model that was built with the same arguments.

    :param folder: from ``find_checkpoint``.
    :param model: a goal learner.
    :return: the ``extra`` passed to ``save_checkpoint``.
    :raises FileNotFoundError: if a file is missing.
    :raises ValueError: if a file is damaged or does not fit the model.
    """
    state = read_state(folder)
    load_policy(folder / POLICY_FILE, model.policy)
    _load_training_tensors(folder / TRAINING_FILE, model)
    model.replay_buffer.load_npz(folder / REPLAY_FILE)
    random = state["random"]
    try:
        model.num_timesteps, model._n_updates, model._episode_num = (
            int(state[name]) for name in ("steps", "updates", "episodes")
        )
        np.random.set_state(random["numpy"])  # noqa: NPY002
        model._exploration_random.bit_generator.state = random["exploration"]
        if "held_actions" in random:  # checkpoints of earlier versions held none
            model.held_actions.load_state_dict(random["held_actions"])
        model.action_space.np_random.bit_generator.state = random["action_space"]
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{folder / STATE_FILE} does not fit this model: {error!r}") from error
    return dict(state["extra"])


def read_state(folder: Path) -> dict[str, Any]:
    """Read a checkpoint's counters and the caller's values, and verify the checksums of its files.

    :param folder: from ``find_checkpoint``.
    :return: ``steps``, ``updates``, ``episodes``, ``random`` and ``extra``.
    :raises FileNotFoundError: if a file is missing.
    :raises ValueError: if a file is damaged.
    """
    path = folder / STATE_FILE
    state = read_json(path)
    wanted = {"steps", "updates", "episodes", "random", "extra", "files", "sha256"}
    lacking = sorted(wanted - set(state)) if isinstance(state, dict) else sorted(wanted)
    if lacking or not isinstance(state["extra"], dict):
        raise ValueError(f"{path} is not a checkpoint's state: it lacks {lacking or 'extra'}")
    if state.pop("sha256") != _checksum(state):
        raise ValueError(f"{path} is damaged: its checksum does not match")
    for name, checksum in state["files"].items():
        if not (folder / name).is_file():
            raise FileNotFoundError(f"{folder / name} is missing: restore it, or start a new run")
        if _file_checksum(folder / name) != checksum:
            raise ValueError(f"{folder / name} is damaged: its checksum does not match")
    return dict(state)


def _checksum(state: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(state, sort_keys=True).encode()).hexdigest()


def _file_checksum(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _counters(model: GoalLearnerMixin) -> dict[str, Any]:
    # Goal learners have their own generators; optional parts of SB3 use NumPy's global one.
    numpy_state: Any = np.random.get_state(legacy=False)  # noqa: NPY002
    numpy_state["state"]["key"] = numpy_state["state"]["key"].tolist()
    return {
        "steps": model.num_timesteps,
        "updates": model._n_updates,
        "episodes": model._episode_num,
        "random": {
            "numpy": numpy_state,
            "exploration": model._exploration_random.bit_generator.state,
            "held_actions": model.held_actions.state_dict(),
            "action_space": model.action_space.np_random.bit_generator.state,
        },
    }


def _training_tensors(model: OffPolicyAlgorithm) -> dict[str, th.Tensor]:
    """Return optimizer moments and other tensors by name, without hyper-parameters."""
    modules, variables = model._get_torch_save_params()
    tensors = {TORCH_RANDOM: th.get_rng_state()}
    for name in modules:
        part = recursive_getattr(model, name)
        if isinstance(part, th.nn.Module):
            if name != "policy":
                tensors |= {f"{name}/{k}": v.detach().clone() for k, v in part.state_dict().items()}
        else:
            for index, moments in part.state_dict()["state"].items():
                for moment, value in moments.items():
                    tensors[f"{name}/{index}/{moment}"] = th.as_tensor(value).detach().cpu().clone()
    for name in variables:
        tensors[f"variable/{name}"] = recursive_getattr(model, name).detach().cpu().clone()
    return tensors


def _load_training_tensors(path: Path, model: OffPolicyAlgorithm) -> None:
    tensors = read_tensors(path)
    modules, variables = model._get_torch_save_params()
    try:
        for name in modules:
            part = recursive_getattr(model, name)
            if not isinstance(part, th.nn.Module):
                _load_optimizer(part, tensors, f"{name}/")
            elif name != "policy":
                part.load_state_dict({key: tensors[f"{name}/{key}"] for key in part.state_dict()})
        for name in variables:
            variable = recursive_getattr(model, name)
            variable.data.copy_(tensors[f"variable/{name}"])
        th.set_rng_state(tensors[TORCH_RANDOM])
    except (KeyError, RuntimeError, ValueError) as error:
        raise ValueError(f"{path} does not fit this model: {error}") from error


def _load_optimizer(
    optimizer: th.optim.Optimizer, tensors: dict[str, th.Tensor], prefix: str
) -> None:
    moments: dict[int, dict[str, th.Tensor]] = {}
    for name, tensor in tensors.items():
        if name.startswith(prefix):
            number, moment = name.removeprefix(prefix).split("/")
            moments.setdefault(int(number), {})[moment] = tensor
    groups = optimizer.state_dict()["param_groups"]
    optimizer.load_state_dict({"state": moments, "param_groups": groups})


def read_tensors(path: Path) -> dict[str, th.Tensor]:
    """Read and verify the tensors of a checkpoint's file.

    :param path: of the file.
    :raises FileNotFoundError: if there is none.
    :raises ValueError: if the file is damaged.
    """
    if not path.exists():
        raise FileNotFoundError(f"there is no file {path}")
    # A run that diverges is still resumed exactly, so infinite values are allowed.
    return read_weights(path, KIND, may_be_infinite=None)[1]


def _swap(partial: Path, folder: Path) -> None:
    """Replace an older folder by a complete one."""
    previous = folder.with_name(f".{folder.name}.previous")
    if folder.exists():
        shutil.rmtree(previous, ignore_errors=True)
        os.replace(folder, previous)
    os.replace(partial, folder)
    shutil.rmtree(previous, ignore_errors=True)
