"""Weight files of pose networks: safetensors with what they belong to."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import torch
from torch import Tensor

from saver_envs.files import written_whole
from saver_envs.perception.network import Architecture, PoseNetwork
from saver_envs.perception.skeleton import LIMB_NAMES, limb_indices

FORMAT: Final = "saver-pose-1"
WEIGHTS_DIR: Final = Path(__file__).parent / "weights"
#: The network that ships.
SHIPPED: Final = WEIGHTS_DIR / "light.safetensors"


def save_network(
    network: PoseNetwork, path: Path, info: Mapping[str, Any], half: bool = True
) -> None:
    """Write weights.

    :param network: trained.
    :param path: ending in ``.safetensors``.
    :param info: JSON-able, anything worth knowing.
    :param half: in 16 bits, which is half the size.
    """
    from safetensors.torch import save as to_bytes

    tensors = {
        name: value.half() if half and value.is_floating_point() else value
        for name, value in network.state_dict().items()
    }
    metadata = {
        "format": FORMAT,
        "architecture": json.dumps(asdict(network.architecture)),
        "limbs": json.dumps(network.limbs),
        "info": json.dumps(dict(info)),
    }
    whole = {name: value.contiguous() for name, value in tensors.items()}
    with written_whole(path) as file:
        file.write(to_bytes(whole, metadata))


def read_info(path: Path) -> dict[str, Any]:
    """Return architecture, limbs and information of a weight file.

    :raises ValueError: where it is no weight file of a pose network.
    """
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, "pt") as file:
            metadata = file.metadata() or {}
    except (SafetensorError, OSError) as error:
        raise ValueError(f"weights={str(path)!r}: {error}") from error
    if metadata.get("format") != FORMAT:
        raise ValueError(f"weights={str(path)!r}: holds no pose network of format {FORMAT}")
    content = {name: json.loads(metadata[name]) for name in ("architecture", "limbs", "info")}
    shape = content["architecture"]
    for stage in ("stage1", "stage2"):
        shape[stage] = tuple((int(kernel), int(width)) for kernel, width in shape[stage])
    content["architecture"] = Architecture(**shape)
    return content


def load_network(path: Path = SHIPPED, limbs: Sequence[str] | None = None) -> PoseNetwork:
    """Return a network with the weights of a file, ready to run.

    :param path: of a file written by :func:`save_network`.
    :param limbs: which branches to load, those of the file where ``None``.
    :raises ValueError: where it is no such file, or lacks branches of ``limbs``: the message names
        them.
    """
    from safetensors.torch import load_file

    content = read_info(path)
    there = content["limbs"]
    wanted = list(there) if limbs is None else [LIMB_NAMES[k] for k in limb_indices(limbs)]
    lacking = [name for name in wanted if name not in there]
    if lacking:
        raise ValueError(
            f"limbs={wanted!r}: {str(path)!r} has no branches of {', '.join(lacking)}; it has "
            f"{', '.join(there)}"
        )
    network = PoseNetwork(content["architecture"], wanted)
    own = network.state_dict()
    tensors: dict[str, Tensor] = {
        name: value.to(own[name].dtype) for name, value in load_file(path).items() if name in own
    }
    network.load_state_dict(tensors)
    with torch.no_grad():
        for value in network.state_dict().values():
            if not torch.isfinite(value).all():
                raise ValueError(f"weights={str(path)!r}: not all weights are finite")
    return network.eval()
