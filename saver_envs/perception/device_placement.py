"""Run the branches of a network on several devices at once."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from functools import partial
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor

from saver_envs.perception.network import Branches, PoseNetwork


class MultiDeviceNetwork:
    """Runs a network with its branches spread over devices.

    Each device runs an equal part of the branches, in the order of the limbs. The backbone runs on
    the first device. GPUs work at the same time because each has its own stream. Parts on the
    processor run in threads, each on one core where PyTorch is set to one thread, because PyTorch
    releases Python's lock while it computes.

    :param network: copied; later changes have no effect.
    :param devices: for example ``["cuda:0", "cuda:1"]``, or ``["cpu", "cpu"]`` for two threads.
    :raises ValueError: for no devices, or more devices than limbs.
    """

    def __init__(self, network: PoseNetwork, devices: Sequence[str | torch.device]) -> None:
        count = len(network.limbs)
        if not 1 <= len(devices) <= count:
            raise ValueError(f"devices={list(devices)!r}: give 1 to {count}, as there are branches")
        self.limbs = network.limbs
        self._devices = [torch.device(device) for device in devices]
        self._network = copy.deepcopy(network).to(self._devices[0])
        bounds = [count * index // len(devices) for index in range(len(devices) + 1)]
        self._stages = [
            [
                _part(stage, stage.limbs[low:high]).to(device)
                for (low, high), device in zip(pairwise(bounds), self._devices, strict=True)
            ]
            for stage in (network.stage1, network.stage2)
        ]
        self._streams = [
            torch.cuda.Stream(device) if device.type == "cuda" else None for device in self._devices
        ]
        self._threads = ThreadPoolExecutor(len(devices), "branches")

    @torch.inference_mode()
    def __call__(self, pictures: Tensor) -> tuple[Tensor, Tensor]:
        """Compute the fields of both stages, as :class:`~.network.PoseNetwork` does.

        :param pictures: (n, 3, h, w), normalised.
        :return: (n, limbs, 3, h/8, w/8) each, on the first device.
        """
        features = self._network.backbone(pictures.to(self._devices[0]))
        stage1, stage2 = (partial(self._run, parts) for parts in self._stages)
        return self._network.run_stages(features, stage1, stage2)

    def close(self) -> None:
        """End the threads."""
        self._threads.shutdown()

    def _run(self, parts: list[Branches], x: Tensor, channels: Tensor | None) -> Tensor:
        home = self._devices[0]
        if home.type == "cuda":
            torch.cuda.synchronize(home)
        jobs = [
            self._threads.submit(_run_part, part, x, channels, device, stream)
            for part, device, stream in zip(parts, self._devices, self._streams, strict=True)
        ]
        return torch.cat([job.result().to(home) for job in jobs], dim=1)


@torch.inference_mode()
def _run_part(
    part: Branches, x: Tensor, channels: Tensor | None, device: torch.device, stream: Any
) -> Tensor:
    with torch.cuda.stream(stream) if stream is not None else nullcontext():
        there = None if channels is None else channels.to(device)
        result: Tensor = part(x.to(device, non_blocking=True), there)
    if stream is not None:
        stream.synchronize()
    return result


def _part(stage: Branches, limbs: Sequence[str]) -> Branches:
    """Return a copy of the branches of some limbs of a stage."""
    part = copy.deepcopy(stage)
    part.limbs = tuple(limbs)
    part.branches = torch.nn.ModuleDict({limb: part.branches[limb] for limb in part.limbs})
    return part
