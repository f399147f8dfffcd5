"""The branches of a network on several devices, which is what makes the ensemble parallel."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor

from saver_envs.perception.network import Branches, PoseNetwork
from saver_envs.perception.skeleton import N_LIMBS


class PlacedNetwork:
    """Runs a network with its branches spread over devices.

    Every device gets an equal share of the branches, in the order of the limbs. The backbone runs
    on the first device. GPUs work at the same time because each has a stream of its own; shares on
    the processor run in threads, each on one core where PyTorch is set to one thread, for PyTorch
    lets go of Python's lock while it computes.

    :param network: copied; later changes to it are not seen.
    :param devices: for example ``["cuda:0", "cuda:1"]``, or ``["cpu", "cpu"]`` for two threads.
    :raises ValueError: where there are no devices, or more than limbs.
    """

    def __init__(self, network: PoseNetwork, devices: Sequence[str | torch.device]) -> None:
        count = len(network.limbs)
        if not 1 <= len(devices) <= count:
            raise ValueError(f"devices={list(devices)!r}: give 1 to {count}, as there are branches")
        self.limbs = network.limbs
        self._devices = [torch.device(device) for device in devices]
        bounds = [count * place // len(devices) for place in range(len(devices) + 1)]
        shares = [range(low, high) for low, high in pairwise(bounds)]
        self._backbone = copy.deepcopy(network.backbone).to(self._devices[0])
        self._channels = None if count == N_LIMBS else network.channels
        self._stages = [
            [
                _part(stage, share).to(device)
                for share, device in zip(shares, self._devices, strict=True)
            ]
            for stage in (network.stage1, network.stage2)
        ]
        self._streams = [
            torch.cuda.Stream(device) if device.type == "cuda" else None for device in self._devices
        ]
        self._threads = ThreadPoolExecutor(len(devices), "branches")

    @torch.inference_mode()
    def __call__(self, pictures: Tensor) -> tuple[Tensor, Tensor]:
        """Return the fields of both stages, as :class:`~.network.PoseNetwork` does.

        :param pictures: (n, 3, h, w), normalised.
        :return: (n, limbs, 3, h/8, w/8) each, on the first device.
        """
        home = self._devices[0]
        features = self._backbone(pictures.to(home))
        first = self._run(self._stages[0], features, None)
        second = self._run(self._stages[1], torch.cat([features, first], dim=1), self._channels)
        shape = (len(self.limbs), 3)
        return first.unflatten(1, shape), second.unflatten(1, shape)

    def close(self) -> None:
        """End the threads."""
        self._threads.shutdown()

    def _run(self, parts: list[Branches], x: Tensor, channels: Tensor | None) -> Tensor:
        home = self._devices[0]
        if home.type == "cuda":
            torch.cuda.synchronize(home)
        jobs = [
            self._threads.submit(_branches, part, x, channels, device, stream)
            for part, device, stream in zip(parts, self._devices, self._streams, strict=True)
        ]
        return torch.cat([job.result().to(home) for job in jobs], dim=1)


@torch.inference_mode()
def _branches(
    part: Branches, x: Tensor, channels: Tensor | None, device: torch.device, stream: Any
) -> Tensor:
    with torch.cuda.stream(stream) if stream is not None else nullcontext():
        there = None if channels is None else channels.to(device)
        result: Tensor = part(x.to(device, non_blocking=True), there)
    if stream is not None:
        stream.synchronize()
    return result


def _part(stage: Branches, share: Iterable[int]) -> Branches:
    """Return a copy of some of a stage's branches."""
    part = copy.deepcopy(stage)
    part.limbs = tuple(stage.limbs[place] for place in share)
    part.branches = torch.nn.ModuleDict({limb: part.branches[limb] for limb in part.limbs})
    return part
