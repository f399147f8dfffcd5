"""Read the networks of a stored model, without unpickling: a run's folder, or a zip file of SB3.

Shapes follow from the tensors. What they do not determine (the order and the sizes of the inputs,
the action's bounds, the activation) comes from the run's environment, or from the readable part of
the zip file, in which SB3 describes the objects that it pickles.
"""

from __future__ import annotations

import io
import json
import pickle
import re
import zipfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, NoReturn

import numpy as np
import torch
from stable_baselines3.common.save_util import load_from_zip_file
from torch import Tensor

from saver_advisors.learner.arms import ArmBlocks
from saver_advisors.policies.expanding import SHARED
from saver_advisors.policies.freezing import build_frozen, build_shared, without_costs
from saver_advisors.policies.networks import ACTIVATIONS, PolicyNetworks
from saver_envs.envs.spaces import action_space, observation_space
from saver_envs.files import read_json
from saver_envs.registration import make_episodes
from saver_envs.weights import check_finite, read_weights

LARGEST: Final = 2**28
"""Bytes that a zip file may expand to; a policy of the package has less than 10 million."""
EXTRACTOR: Final = "actor.features_extractor."
NORMALISER_CLIP: Final = 5.0
"""Default of `NormalizedGoalFeatures`."""
POLICIES: Final = (
    *("stable_baselines3.td3.policies", "stable_baselines3.sac.policies"),
    *("sb3_contrib.tqc.policies", "saver_advisors.learner.policies"),
    "saver_advisors.learner.shared_arms",
)
"""Modules of the policies whose networks follow from their tensors and their activation."""


def networks_of_run(folder: Path) -> PolicyNetworks:
    """Read the networks of a run of `saver train`: its best policy, or the latest if it has none.

    :param folder: the run's folder.
    :raises ValueError: if a file is missing or damaged; the message names it.
    """
    found = [one for which in ("best", "latest") if (one := folder / which).is_dir()]
    if not found or not (folder / "run.json").is_file():
        raise ValueError(f"{folder} is not the folder of a run that has a policy yet")
    path = found[0] / "policy.safetensors"
    state = read_weights(path, "saver-checkpoint")[1]
    record = read_json(folder / "run.json")
    try:
        config = record["config"]
        # The last thing to do: an id may name a module, which is then imported.
        episodes = make_episodes(config["env_id"], **config["env_kwargs"])
    except (LookupError, TypeError) as error:
        raise ValueError(f"{folder / 'run.json'} is not the record of a run: {error!r}") from error
    sizes = {key: int(box.shape[0]) for key, box in observation_space(episodes).items()}  # type: ignore[index]
    box = action_space(episodes)
    return _networks(
        path, state, sizes, (box.low, box.high), arms=lambda: ArmBlocks.of_episodes(episodes)
    )


def networks_of_zip(path: Path) -> PolicyNetworks:
    """Read the networks of a model that SB3 saved: DDPG, TD3, SAC or TQC, or a goal learner.

    :param path: of the zip file.
    :raises ValueError: if it is damaged, or describes something that is only known after
        unpickling; the message names what works instead.
    """
    # RL Zoo writes it beside its models, or in a folder there.
    if [*path.parent.glob("vecnormalize.pkl"), *path.parent.glob("*/vecnormalize.pkl")]:
        _refuse(path, "its observations were normalised by VecNormalize, which is pickled")
    try:
        with zipfile.ZipFile(path) as archive:
            _check_size(path, archive)
            data = json.loads(archive.read("data"))
            for name in archive.namelist():
                if name.endswith(".pth"):
                    with zipfile.ZipFile(io.BytesIO(archive.read(name))) as inner:
                        _check_size(path, inner)
        loaded: Any = load_from_zip_file(path, load_data=False, device="cpu")[1]["policy"]
        state = {name: one for name, one in loaded.items() if isinstance(one, Tensor)}
        spaces, actions = data["observation_space"]["spaces"], data["action_space"]
        sizes = {name: int(size) for name, size in _BOX.findall(spaces)}
        bounds = [
            np.array(actions[end].strip("[] ").split(), np.float32) for end in ("low", "high")
        ]
        arguments, module = dict(data["policy_kwargs"]), data["policy_class"]["__module__"]
        noise, more = data["use_sde"], dict(arguments.get("features_extractor_kwargs", {}))
    except (
        *(OSError, EOFError, LookupError, TypeError, ValueError, AttributeError, RuntimeError),
        *(zipfile.BadZipFile, zlib.error, pickle.UnpicklingError),
    ) as error:
        if str(error).startswith(str(path)):
            raise
        _refuse(path, f"it is not a complete model with a goal environment ({error!r})")
    words = re.search(r"(\w+)'>$", str(arguments.get("activation_fn", "ReLU'>")))
    names = {kind.__name__: name for name, kind in ACTIVATIONS.items()}
    activation = names.get(words[1] if words else "", "")
    for wrong, reason in (
        (module not in POLICIES, f"its policy is one of {module}"),
        (noise, "it explores with gSDE"),
        (len(sizes) != spaces.count("Box("), f"its observation is {spaces}"),
        (not activation, f"its activation is {arguments.get('activation_fn')}"),
        (
            "features_extractor_class" in arguments or set(more) - {"achieved_goal"},
            "it has features of its own",
        ),
    ):
        if wrong:
            _refuse(path, reason)
    described = arguments.get("arms")
    arms = None if described is None else lambda: ArmBlocks.from_mapping(described)
    return _networks(path, state, sizes, (bounds[0], bounds[1]), activation, arms)


_BOX: Final = re.compile(r"'(\w+)'[:,] Box\([^()]*\((\d+),\), \w+\)")


def _refuse(path: Path, reason: str) -> NoReturn:
    raise ValueError(
        f"{path} cannot be read without unpickling it: {reason}. If you trust it, load it yourself "
        "and pass Teacher.from_sb3(model); of a run of `saver train`, give the folder"
    )


def _check_size(path: Path, archive: zipfile.ZipFile) -> None:
    """Reject a file that expands to more than ``LARGEST``, before anything is expanded."""
    size = sum(info.file_size for info in archive.infolist())
    if size > LARGEST:
        raise ValueError(f"{path} expands to {size:,} bytes: at most {LARGEST:,} are read")


def _networks(
    path: Path,
    state: Mapping[str, Tensor],
    sizes: Mapping[str, int],
    bounds: tuple[Any, Any],
    activation: str = "relu",
    arms: Callable[[], ArmBlocks] | None = None,
) -> PolicyNetworks:
    """Build frozen networks from the tensors of a policy of SB3 or of a goal learner.

    :param arms: gives the arms, for networks that they share.
    """
    try:
        names = sorted({name.split(".")[1] for name in state if name.startswith("critic.qf")})
        low, high = (torch.as_tensor(end) for end in bounds)
        if f"actor.mu.{SHARED}" in state:
            shared = [_part(state, f"critic.{name}") for name in names]
            networks = _shared_networks(state, shared, arms, (low, high))
            check_finite(path, networks.state_dict(), {"clip"})
            return networks
        actor = _layers(state, "actor.mu")
        if not actor:  # SAC and TQC keep the last layer apart
            last = state["actor.mu.weight"], state["actor.mu.bias"]
            actor = [*_layers(state, "actor.latent_pi"), last]
        n_costs = int(state.get("critic.cost_outputs", 0))
        critics = [without_costs(_layers(state, f"critic.{name}"), n_costs) for name in names]
        read = actor[0][0].shape[-1]
        # SB3 reads the entries in sorted order, the goal learners in their own.
        keys: tuple[str, ...] = tuple(sorted(sizes))
        mean, std, clip = torch.zeros(read), torch.ones(read), torch.full((read,), torch.inf)
        if f"{EXTRACTOR}shift" in state:
            keys = ("observation", "desired_goal", "achieved_goal")
            keys = keys[:2] if sum(sizes.get(key, 0) for key in keys[:2]) == read else keys
            mean, std, clip = _statistics(state)
        inputs = tuple((key, sizes[key]) for key in keys)
        networks = build_frozen(actor, critics, inputs, (mean, std, clip), (low, high), activation)
    except (LookupError, RuntimeError, TypeError, ValueError) as error:
        raise ValueError(f"{path} has networks that cannot be frozen: {error}") from error
    check_finite(path, networks.state_dict(), {"clip"})
    return networks


def _shared_networks(
    state: Mapping[str, Tensor],
    critics: list[dict[str, Tensor]],
    arms: Callable[[], ArmBlocks] | None,
    bounds: tuple[Tensor, Tensor],
) -> PolicyNetworks:
    """Build frozen networks from the tensors of networks that arms share."""
    if arms is None:
        raise ValueError("arms share the networks, but the file does not describe the arms")
    blocks, statistics = arms(), _statistics(state)
    sizes = blocks.sizes_of_arm()
    keys: tuple[str, ...] = ("observation", "desired_goal", "achieved_goal")
    if sum(sizes[key] for key in keys[:2]) == len(statistics[0]):
        keys = keys[:2]
    return build_shared(_part(state, "actor.mu"), critics, blocks, keys, statistics, bounds)


def _statistics(state: Mapping[str, Tensor]) -> tuple[Tensor, Tensor, Tensor]:
    """Return mean, standard deviation and clip of a goal learner's inputs."""
    mean = state[f"{EXTRACTOR}shift"]
    return mean, 1.0 / state[f"{EXTRACTOR}scale"], torch.full_like(mean, NORMALISER_CLIP)


def _part(state: Mapping[str, Tensor], name: str) -> dict[str, Tensor]:
    """Return the entries of one network."""
    prefix = f"{name}."
    return {k.removeprefix(prefix): one for k, one in state.items() if k.startswith(prefix)}


def _layers(state: Mapping[str, Tensor], prefix: str) -> list[tuple[Tensor, Tensor]]:
    """Return weight and bias of each layer of a sequence, in order."""
    pattern = re.compile(re.escape(prefix) + r"\.(\d+)\.weight")
    numbers = sorted(int(found[1]) for name in state if (found := pattern.fullmatch(name)))
    return [(state[f"{prefix}.{one}.weight"], state[f"{prefix}.{one}.bias"]) for one in numbers]
