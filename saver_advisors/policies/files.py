"""Policy files: float32 tensors and a JSON card, with a readable copy of the card beside them."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from dataclasses import replace
from os import PathLike, fspath
from pathlib import Path
from typing import Any, Final

import torch

from saver_advisors.policies.cards import PolicyCard, card_markdown
from saver_advisors.policies.frozen import PretrainedPolicy
from saver_advisors.policies.networks import PolicyNetworks
from saver_advisors.policies.stored_models import networks_of_run, networks_of_zip
from saver_advisors.policies.teacher import Teacher
from saver_envs.weights import Header, Shapes, check_finite, read_weights, write_weights

KIND: Final = "saver-policy"
"""Distinguishes policy files from other weight files."""

WEIGHTS_DIR: Final = Path(__file__).parents[1] / "pretrained" / "weights"
"""The folder of the shipped policies: `<name>.safetensors`, with `<name>.md` beside it."""

_MAY_BE_INFINITE: Final = {"clip"}
"""Features without clipping have an infinite bound; every other tensor must be finite."""


def shipped_policies() -> list[str]:
    """Return the names that `load_policy` accepts, sorted."""
    return sorted(path.stem for path in WEIGHTS_DIR.glob("*.safetensors"))


def save_policy(
    path: str | Path,
    policy: PolicyNetworks | Teacher | PretrainedPolicy,
    card: PolicyCard | Mapping[str, Any],
) -> Path:
    """Write a weight file and its readable card.

    :param path: of the file; must end in `.safetensors`.
    :param policy: networks, a teacher or a policy.
    :param card: the origin of the policy; its `networks` entry is filled in.
    :return: the path.
    :raises ValueError: for an invalid path, card or weights.
    """
    path = Path(path)
    if path.suffix != ".safetensors":
        raise ValueError(f"path={str(path)!r} must end in '.safetensors'")
    card = card if isinstance(card, PolicyCard) else PolicyCard.from_dict(card)
    networks = policy if isinstance(policy, PolicyNetworks) else policy.networks
    tensors = networks.state_dict()
    check_finite(path, tensors, _MAY_BE_INFINITE)
    _checked(path, networks)
    path.parent.mkdir(parents=True, exist_ok=True)
    header = {"card": replace(card, networks=networks.spec).to_json()}
    write_weights(path, KIND, tensors, header)
    write_card(path)
    return path


def load_policy(name_or_path: str | PathLike[str]) -> PretrainedPolicy:
    """Load a policy for inference.

    :param name_or_path: a shipped policy's name such as "jaco-push", or the path of a weight file.
    :raises ValueError: for an unknown name, or a file that is damaged or of another kind.
    """
    path = _find(name_or_path)
    networks, card = read_networks(path)
    return PretrainedPolicy(networks, card, name=path.stem)


def load_teacher(name_or_path: str | PathLike[str]) -> Teacher:
    """Load a teacher.

    :param name_or_path: as for `load_policy`; or the folder of a run of `saver train`, for its best
        policy; or the zip file of a model that SB3 saved, which is read without unpickling it.
    :raises ValueError: as for `load_policy`, or for a model that cannot be read.
    """
    path = Path(name_or_path)
    if os.path.isdir(path):  # unlike Path's, it is False for a name that is too long
        return Teacher(_checked(path, networks_of_run(path)), path.resolve().name)
    if path.suffix == ".zip" and os.path.isfile(path):
        return Teacher(_checked(path, networks_of_zip(path)), path.stem)
    return load_policy(name_or_path).teacher()


def weights_digest(name_or_path: str) -> str | None:
    """Return a digest of a weight file, which tells two policies of the same name apart.

    :param name_or_path: a shipped policy's name, or the path of a weight file.
    :return: None for all else.
    """
    path = WEIGHTS_DIR / f"{name_or_path}.safetensors"
    path = path if os.path.isfile(path) else Path(name_or_path)
    if not os.path.isfile(path):
        return None
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:16]


def _find(name_or_path: str | PathLike[str]) -> Path:
    """Return the path of a weight file.

    :raises ValueError: if it is neither a shipped name nor a file.
    """
    path = Path(name_or_path)
    there = os.path.isfile(path)
    if path.suffix == ".safetensors" or there or len(path.parts) > 1:
        if not there:
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
    """Read and verify a policy file.

    :param path: of the file.
    :return: networks and card.
    :raises ValueError: if the file is damaged, inconsistent or of another kind; the message names
        it.
    """
    header, tensors = read_weights(path, KIND, _shapes, may_be_infinite=_MAY_BE_INFINITE)
    card = PolicyCard.from_json(header["card"])
    assert card.networks is not None  # checked with the shapes
    networks = PolicyNetworks(card.networks)
    networks.load_state_dict(tensors, strict=True)
    return _checked(path, networks), card


def _shapes(header: Header) -> Shapes:
    spec = PolicyCard.from_json(header["card"]).networks
    if spec is None:
        raise ValueError("the card does not describe the networks")
    with torch.device("meta"):
        return PolicyNetworks(spec).state_dict()


def _checked(path: Path, networks: PolicyNetworks) -> PolicyNetworks:
    if (networks.std <= 0).any() or (networks.clip <= 0).any():
        raise ValueError(f"{path}: std and clip must be positive")
    if (networks.action_high <= networks.action_low).any():
        raise ValueError(f"{path}: action_high must exceed action_low")
    return networks


def write_card(weights: str | Path) -> Path:
    """Write the readable card `<name>.md` beside a weight file.

    :param weights: the weight file.
    :return: the path of the card.
    """
    path = Path(weights)
    _, card = read_networks(path)
    target = path.with_suffix(".md")
    target.write_text(card_markdown(path.stem, card), encoding="utf-8")
    return target
