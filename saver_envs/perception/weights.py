"""Weight files of pose networks: weights, architecture, limbs and information on the training."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import torch

from saver_envs.perception.network import PoseArchitecture, PoseNetwork
from saver_envs.perception.skeleton import LIMB_NAMES, limb_indices
from saver_envs.weights import Header, Shapes, read_header, read_weights, write_weights

KIND: Final = "saver-pose"
#: What a header of other types or numbers raises.
MALFORMED: Final = (LookupError, TypeError, ValueError, OverflowError, RecursionError)
#: The network that ships.
SHIPPED: Final = Path(__file__).parent / "weights" / "light.safetensors"


def save_network(
    network: PoseNetwork, path: Path, info: Mapping[str, Any], half: bool = True
) -> None:
    """Write weights.

    :param network: a trained network.
    :param path: ending in ``.safetensors``.
    :param info: of the training, JSON-able.
    :param half: whether to store 16-bit floats, which halves the size.
    """
    tensors = {
        name: value.half() if half and value.is_floating_point() else value
        for name, value in network.state_dict().items()
    }
    header = {
        "architecture": json.dumps(asdict(network.architecture)),
        "limbs": json.dumps(network.limbs),
        "info": json.dumps(dict(info)),
    }
    write_weights(path, KIND, tensors, header)


def read_info(path: Path) -> dict[str, Any]:
    """Return architecture, limbs and information of a weight file.

    :param path: of a file written by :func:`save_network`.
    :raises ValueError: if it is not a weight file of a pose network.
    """
    header = read_header(path, KIND)
    try:
        return _content(header)
    except MALFORMED as error:
        raise ValueError(f"{path} contradicts itself: {error}") from error


def load_network(path: Path = SHIPPED, limbs: Sequence[str] | None = None) -> PoseNetwork:
    """Return a network with the weights of a file, ready to run.

    :param path: of a file written by :func:`save_network`.
    :param limbs: which branches to load; None: all those of the file.
    :raises ValueError: if it is not such a file, or lacks branches of ``limbs``: the message names
        them.
    """
    header, tensors = read_weights(path, KIND, _shapes, half=True)
    content = _content(header)
    there = content["limbs"]
    wanted = list(there) if limbs is None else [LIMB_NAMES[k] for k in limb_indices(limbs)]
    lacking = [name for name in wanted if name not in there]
    if lacking:
        raise ValueError(
            f"limbs={wanted!r}: {str(path)!r} has no branches of {', '.join(lacking)}; it has "
            f"{', '.join(there)}"
        )
    network = PoseNetwork(content["architecture"], wanted)
    network.load_state_dict({name: tensors[name] for name in network.state_dict()})
    return network.eval()


def _content(header: Header) -> dict[str, Any]:
    content = {name: json.loads(header[name]) for name in ("architecture", "limbs", "info")}
    shape = content["architecture"]
    for stage in ("stage1", "stage2"):
        shape[stage] = tuple((int(kernel), int(width)) for kernel, width in shape[stage])
    content["architecture"] = PoseArchitecture(**shape)
    content["limbs"] = [LIMB_NAMES[k] for k in limb_indices(list(content["limbs"]))]
    return content


def _shapes(header: Header) -> Shapes:
    content = _content(header)
    with torch.device("meta"):
        return PoseNetwork(content["architecture"], content["limbs"]).state_dict()
