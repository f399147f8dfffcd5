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
from pathlib import Path
from typing import Any, Final, NoReturn

import torch
from stable_baselines3.common.save_util import load_from_zip_file
from torch import Tensor

from saver_advisors.learner.arms import ArmBlocks
from saver_advisors.policies.freezing import networks_of_state
from saver_advisors.policies.networks import ACTIVATIONS, PolicyNetworks
from saver_envs.envs.spaces import action_space, observation_space
from saver_envs.files import read_json
from saver_envs.registration import make_episodes
from saver_envs.weights import check_finite, read_weights

LARGEST: Final = 2**28
"""Bytes that a zip file may expand to; a policy of the package has less than 10 million."""
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
    bounds = torch.as_tensor(box.low), torch.as_tensor(box.high)
    return _networks(path, state, sizes, bounds, "relu", lambda: ArmBlocks.of_episodes(episodes))


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
            torch.tensor([float(one) for one in actions[end].strip("[] ").split()])
            for end in ("low", "high")
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
    return _networks(path, state, sizes, bounds, activation, arms)


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


def _networks(path: Path, *arguments: Any) -> PolicyNetworks:
    """Call `networks_of_state` with errors that name the file."""
    try:
        networks = networks_of_state(*arguments)
    except (LookupError, RuntimeError, TypeError, ValueError) as error:
        raise ValueError(f"{path} has networks that cannot be frozen: {error}") from error
    check_finite(path, networks.state_dict(), {"clip"})
    return networks
