"""The weight file: safetensors with float32 tensors and a JSON card in its header. Nothing in it is
executable.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from os import PathLike, fspath
from pathlib import Path
from typing import Any, Final

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save as to_bytes
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from torch import Tensor

from saver_advisors.policies.cards import PolicyCard, card_markdown
from saver_advisors.policies.freezing import networks_from_sb3
from saver_advisors.policies.frozen import PretrainedPolicy
from saver_advisors.policies.networks import NetworkSpec, PolicyNetworks
from saver_advisors.policies.teacher import Teacher
from saver_envs.files import written_whole

FORMAT: Final = "saver-policy-1"
"""Stands in the header, so that a foreign safetensors file is told apart from ours."""

WEIGHTS_DIR: Final = Path(__file__).parents[1] / "pretrained" / "weights"
"""Where the shipped policies live, `<name>.safetensors` with `<name>.md` beside it."""

_MAY_BE_INFINITE: Final = {"clip"}
"""An entry that is not clipped has an infinite bound; every other tensor must be finite."""


def shipped_policies() -> list[str]:
    """:return: the names that `load_policy` knows, sorted"""
    return sorted(path.stem for path in WEIGHTS_DIR.glob("*.safetensors"))


def save_policy(
    path: str | Path,
    policy: PolicyNetworks | Teacher | PretrainedPolicy | Mapping[str, Tensor],
    card: PolicyCard | Mapping[str, Any],
) -> Path:
    """Write a weight file and its readable card.

    :param path: where to; must end in `.safetensors`
    :param policy: networks, a teacher or a policy; or the `state_dict` of networks that
        `card.networks` describes
    :param card: where the policy comes from; its `networks` entry is filled in
    :return: the path
    :raises ValueError: where path, card or weights are not what they should be
    """
    path = Path(path)
    if path.suffix != ".safetensors":
        raise ValueError(f"path={str(path)!r} must end in '.safetensors'")
    card = card if isinstance(card, PolicyCard) else PolicyCard.from_dict(card)
    networks = _networks(policy, card)
    tensors = {name: value.contiguous() for name, value in networks.state_dict().items()}
    _check_finite(tensors, str(path))
    metadata = {"format": FORMAT, "card": card.with_networks(networks.spec).to_json()}
    path.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(path) as file:
        file.write(to_bytes(tensors, metadata))
    write_card(path)
    return path


def export_policy(
    model: OffPolicyAlgorithm, path: str | Path, card: PolicyCard | Mapping[str, Any]
) -> Path:
    """Write the deterministic policy and the critics of a trained SB3 model.

    :param model: DDPG, TD3, SAC or TQC on a goal environment, of SB3 or of the learner room
    :param path: where to; must end in `.safetensors`
    :param card: where the policy comes from
    :return: the path
    :raises TypeError: for models that cannot be represented
    """
    return save_policy(path, networks_from_sb3(model), card)


def load_policy(name_or_path: str | PathLike[str]) -> PretrainedPolicy:
    """A policy for inference.

    :param name_or_path: a shipped policy's name such as "jaco-push", or the path of a weight file
    :raises ValueError: for an unknown name, or a file that is truncated or not ours
    """
    path = _find(name_or_path)
    networks, card = read_networks(path)
    return PretrainedPolicy(networks, card, name=path.stem)


def load_teacher(name_or_path: str | PathLike[str]) -> Teacher:
    """A teacher from a weight file.

    :param name_or_path: as for `load_policy`
    :raises ValueError: as `load_policy`
    """
    return load_policy(name_or_path).teacher()


def _find(name_or_path: str | PathLike[str]) -> Path:
    """:raises ValueError: where neither a shipped name nor a file is meant"""
    path = Path(name_or_path)
    if path.suffix == ".safetensors" or path.is_file() or len(path.parts) > 1:
        if not path.is_file():
            raise ValueError(f"there is no weight file {str(path)!r}")
        return path
    name, names = fspath(name_or_path), shipped_policies()
    if name not in names:
        raise ValueError(
            f"policy {name!r} is unknown: the shipped ones are {', '.join(names) or 'none'}; "
            "or give the path of a '.safetensors' file"
        )
    return WEIGHTS_DIR / f"{name}.safetensors"


def read_networks(path: Path) -> tuple[PolicyNetworks, PolicyCard]:
    """Read and check a weight file; nothing is unpickled and no size is taken on trust.

    :param path: the file
    :return: networks and card
    :raises ValueError: where the file is truncated, foreign or inconsistent; the message names it
    """
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            names = list(file.keys())
            tensors = {name: file.get_tensor(name) for name in names}
    except (SafetensorError, OSError) as error:
        raise ValueError(f"{path} is not a complete safetensors file: {error}") from error
    if metadata.get("format") != FORMAT:
        raise ValueError(f"{path} is no policy of ours: its header does not say {FORMAT!r}")
    try:
        card = PolicyCard.from_json(metadata["card"])
        if card.networks is None:
            raise ValueError("the card does not describe the networks")
        _check_sizes(card.networks, tensors)
        networks = PolicyNetworks(card.networks)
        networks.load_state_dict(tensors, strict=True)
    except (KeyError, json.JSONDecodeError, ValueError, RuntimeError) as error:
        raise ValueError(f"{path} contradicts itself: {error}") from error
    _check_finite(tensors, str(path))
    return networks, card


def _networks(
    policy: PolicyNetworks | Teacher | PretrainedPolicy | Mapping[str, Tensor], card: PolicyCard
) -> PolicyNetworks:
    if isinstance(policy, PolicyNetworks):
        return policy
    if isinstance(policy, (Teacher, PretrainedPolicy)):
        return policy.networks
    if card.networks is None:
        raise ValueError("a state_dict alone does not say its shapes: set card.networks")
    networks = PolicyNetworks(card.networks)
    try:
        networks.load_state_dict(dict(policy), strict=True)
    except RuntimeError as error:
        raise ValueError(f"the state_dict does not fit card.networks: {error}") from error
    return networks


def _check_sizes(spec: NetworkSpec, tensors: Mapping[str, Tensor]) -> None:
    """Compare with a skeleton that has shapes and no memory, before anything is allocated."""
    with torch.device("meta"):
        expected = PolicyNetworks(spec).state_dict()
    if set(expected) != set(tensors):
        raise ValueError(f"tensors {sorted(set(expected) ^ set(tensors))} are missing or surplus")
    for name, value in expected.items():
        given = tensors[name]
        if given.shape != value.shape or given.dtype != torch.float32:
            raise ValueError(
                f"{name} is {given.dtype} {tuple(given.shape)}, but the card asks for float32 "
                f"{tuple(value.shape)}"
            )


def _check_finite(tensors: Mapping[str, Tensor], where: str) -> None:
    for name, value in tensors.items():
        bad = torch.isnan(value) if name in _MAY_BE_INFINITE else ~torch.isfinite(value)
        if bad.any():
            raise ValueError(f"{where}: {name} holds values that are not finite")
    if (tensors["std"] <= 0).any() or (tensors["clip"] <= 0).any():
        raise ValueError(f"{where}: std and clip must be positive")
    if (tensors["action_high"] <= tensors["action_low"]).any():
        raise ValueError(f"{where}: action_high must exceed action_low")


def write_card(weights: str | Path) -> Path:
    """Write `<name>.md` beside a weight file.

    :param weights: the weight file
    :return: where the card was written
    """
    path = Path(weights)
    _, card = read_networks(path)
    target = path.with_suffix(".md")
    target.write_text(card_markdown(path.stem, card), encoding="utf-8")
    return target
