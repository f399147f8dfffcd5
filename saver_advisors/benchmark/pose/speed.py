"""Time a pose network's parts, with its branches together, in sequence and in threads."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from statistics import median
from typing import Any, Final

import numpy as np
import torch

from saver_advisors.benchmark.machine import cores, timed
from saver_advisors.training.threads import threads_of_algebra
from saver_envs.perception.device_placement import MultiDeviceNetwork
from saver_envs.perception.fields import encode
from saver_envs.perception.network import ARCHITECTURES, PoseNetwork
from saver_envs.perception.parsing import parse
from saver_envs.perception.skeleton import LIMB_NAMES, N_JOINTS

SIZES: Final = ((216, 256), (368, 368))
#: Limbs of the timed networks: all, four, two.
LIMB_SETS: Final[tuple[tuple[str, ...], ...]] = (
    LIMB_NAMES,
    ("right_upper_arm", "right_forearm", "left_upper_arm", "left_forearm"),
    ("right_forearm", "left_forearm"),
)


def speed_row(
    architecture: str, size: tuple[int, int], threads: int, limbs: tuple[str, ...], rounds: int
) -> dict[str, Any]:
    """Time a network with random weights.

    :param architecture: ``light`` or ``vgg19``.
    :param size: height and width of the picture.
    :param threads: number of threads and cores.
    :param limbs: of the network.
    :param rounds: number of interleaved rounds; the figures are medians.
    :return: a JSON-able row.
    """
    network = PoseNetwork(ARCHITECTURES[architecture], limbs).eval()
    pictures = torch.randn(1, 3, *size, generator=torch.Generator().manual_seed(0))
    with cores(threads), torch.inference_mode(), threads_of_algebra(threads):
        features = network.backbone(pictures)
        first = network.stage1(features)
        joined = torch.cat([features, first], dim=1)
        channels = network.stage2_channels
        work: dict[str, Callable[[], object]] = {
            "backbone": lambda: network.backbone(pictures),
            "stage1": lambda: network.stage1(features),
            "stage2": lambda: network.stage2(joined, channels),
            "stage1_sequential": lambda: network.stage1.one_by_one(features),
            "stage2_sequential": lambda: network.stage2.one_by_one(joined, channels),
            "network": lambda: network(pictures),
        }
        exported = _exported(network, size, threads)
        if exported is not None:
            work["network_onnxruntime"] = partial(exported, pictures.numpy())
        placed = None
        if threads > 1 and len(limbs) >= threads:
            torch.set_num_threads(1)
            placed = MultiDeviceNetwork(network, ["cpu"] * threads)
            work["network_branches_in_threads"] = lambda: placed(pictures)
        spent: dict[str, list[float]] = {name: [] for name in work}
        for _ in range(rounds + 1):
            for name, one in work.items():
                torch.set_num_threads(1 if name.endswith("in_threads") else threads)
                spent[name].append(timed(one))
        if placed is not None:
            placed.close()
    return {
        "architecture": architecture,
        "height": size[0],
        "width": size[1],
        "threads": threads,
        "limbs": len(limbs),
        # The first round warms up.
        "milliseconds": {name: 1e3 * median(times[1:]) for name, times in spent.items()},
    }


def _exported(
    network: PoseNetwork, size: tuple[int, int], threads: int
) -> Callable[..., object] | None:
    """Return a light network of all limbs in onnxruntime; None if that is not installed."""
    if network.architecture.backbone != "light" or len(network.limbs) < len(LIMB_NAMES):
        return None
    if not all(find_spec(name) for name in ("onnx", "onnxruntime", "onnxscript")):
        return None
    from saver_envs.perception.onnx import OnnxNetwork, export_onnx

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "network.onnx"
        export_onnx(network, path, size)
        return OnnxNetwork(path, threads)


def parsing_rows(rounds: int) -> list[dict[str, Any]]:
    """Time the parsing of 1 to 10 encoded people with a little noise.

    :param rounds: a quarter of the number of measurements.
    :return: JSON-able rows.
    """
    rows = []
    for size, people in product(SIZES, (1, 2, 5, 10)):
        joints = _crowd(people, size)
        fields = encode(joints, np.ones((people, N_JOINTS), dtype=bool), size, range(13))
        noise = np.random.default_rng(0).normal(0, 0.03, fields.shape)
        noisy = (fields + noise).astype(np.float32)
        found = len(parse(noisy, range(13)))
        times = [timed(partial(parse, noisy, range(13))) for _ in range(4 * rounds)]
        rows.append(
            {
                "height": size[0],
                "width": size[1],
                "people": people,
                "found": found,
                "milliseconds": 1e3 * median(times),
            }
        )
    return rows


def _crowd(people: int, size: tuple[int, int]) -> Any:
    """Return standing people (people, 14, 2) side by side, more than five in two rows."""
    upright = np.array(
        [
            (0, 0), (0, -0.18), (-0.16, 0.02), (-0.24, 0.2), (-0.27, 0.38), (0.16, 0.02),
            (0.24, 0.2), (0.27, 0.38), (-0.1, 0.36), (-0.11, 0.62), (-0.12, 0.86), (0.1, 0.36),
            (0.11, 0.62), (0.12, 0.86),
        ]
    )  # fmt: skip
    lines = 1 if people <= 5 else 2
    columns = -(-people // lines)
    height, width = size[0] / lines, size[1] / columns
    scale = min(0.85 * height, 1.6 * width)
    centres = [
        ((place % columns + 0.5) * width, (place // columns + 0.22) * height)
        for place in range(people)
    ]
    return np.array(centres)[:, None] + scale * upright
