"""Train a pose network: batches, optimiser, averaged weights, checkpoints, curve."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from saver_envs.perception.augment import Augmentation, augment
from saver_envs.perception.dataset import (
    Example,
    PoseDataset,
    RenderedDataset,
    differing_settings,
)
from saver_envs.perception.estimator import NETWORK_SIZE, PoseEstimator, normalised
from saver_envs.perception.fields import encode, loss_mask
from saver_envs.perception.metrics import PoseAccuracy, joint_errors, summarise
from saver_envs.perception.network import ARCHITECTURES, PoseNetwork, field_loss
from saver_envs.perception.weights import save_network
from saver_envs.weights import read_weights, write_weights

CHECKPOINT: Final = "checkpoint.safetensors"
#: What the header of a checkpoint says.
RUN_KIND: Final = "saver-pose-run"
CURVE: Final = "curve.jsonl"
NETWORK: Final = "network.safetensors"


@dataclass(frozen=True)
class PoseTrainingOptions:
    """Settings of a training run.

    :param architecture: ``light`` or ``vgg19``.
    :param limbs: names of the limbs whose branches are trained; ``None``: all 13.
    :param frames: number of pictures in the run, with repetition.
    :param batch: pictures per step.
    :param learning_rate: peak value; it rises over the first 2% of the run and then falls as a
        cosine.
    :param weight_decay: decoupled.
    :param heat_weight: weight of the heat's error; that of the affinities' is 1.
    :param small_share: first fraction of the run, which uses pictures of 3/4 of the size at half
        the cost.
    :param average: decay of the moving average of the weights.
    :param limb_dropout: probability that stage 2 does not receive stage 1's fields of some limbs,
        which prepares it for running without these limbs.
    :param bfloat16: compute in 16 bits, twice as fast on processors that support it.
    :param seed: seed of the run.
    :param augmentation: of the pictures.
    """

    architecture: str = "light"
    limbs: tuple[str, ...] | None = None
    frames: int = 120_000
    batch: int = 16
    learning_rate: float = 2e-3
    weight_decay: float = 1e-4
    heat_weight: float = 2.0
    small_share: float = 0.6
    average: float = 0.998
    limb_dropout: float = 0.25
    bfloat16: bool = True
    seed: int = 0
    augmentation: Augmentation = field(default_factory=Augmentation)


class PoseTrainer:
    """A training run in a folder; a new trainer on the same folder resumes the run.

    :param folder: holds checkpoint, curve and network.
    :param data: training pictures.
    :param validation: rendered pictures for the evaluations.
    :param options: settings of the run.
    :param measured: largest number of pictures per evaluation.
    :raises ValueError: if the folder holds a run with other options.
    """

    def __init__(
        self,
        folder: Path,
        data: PoseDataset,
        validation: RenderedDataset,
        options: PoseTrainingOptions = PoseTrainingOptions(),
        measured: int = 120,
    ) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.options = folder, options
        self._data, self._validation, self._measured = data, validation, measured
        if other := differing_settings(folder / "options.json", asdict(options)):
            raise ValueError(f"{folder} holds a run with other options: {', '.join(other)}")
        torch.manual_seed(options.seed)
        self.network = PoseNetwork(ARCHITECTURES[options.architecture], options.limbs)
        # The channels-last memory format is faster on processors.
        self.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self._optimiser = torch.optim.AdamW(
            self.network.parameters(), lr=options.learning_rate, weight_decay=options.weight_decay
        )
        self._average = {name: value.clone() for name, value in self.network.state_dict().items()}
        self.frames, self.seconds = 0, 0.0
        if (folder / CHECKPOINT).is_file():
            self._restore()

    def run(
        self,
        until: float = math.inf,
        checkpoint_every: float = 180.0,
        measure_every: int = 6000,
        progress: Callable[[int, str], None] | None = None,
    ) -> None:
        """Train to the end, or for a limited time.

        :param until: seconds, after which the run stops with a checkpoint.
        :param checkpoint_every: seconds between two checkpoints.
        :param measure_every: frames between two evaluations.
        :param progress: called with the number of frames and a line of text after each step.
        """
        began, saved = time.monotonic(), time.monotonic()
        before, running, text = self.seconds, math.nan, ""
        batches = self._batches()
        while self.frames < self.options.frames and time.monotonic() - began < until:
            loss = self._step(next(batches))
            running = loss if math.isnan(running) else 0.98 * running + 0.02 * loss
            self.seconds = before + time.monotonic() - began
            if self.frames % measure_every < self.options.batch:
                summary = self.measure()
                self._note(running, summary)
                text = f" pck {summary.pck:.3f}"
            if time.monotonic() - saved > checkpoint_every:
                self.save()
                saved = time.monotonic()
            if progress is not None:
                progress(self.options.batch, f"loss {running:.1f}{text}")
        self.save()

    def measure(self) -> PoseAccuracy:
        """Evaluate the averaged weights on the validation pictures."""
        estimator = PoseEstimator(self.averaged())
        errors = []
        for index in range(min(self._measured, len(self._validation))):
            example = self._validation[index]
            seen = self._validation.visibility(index)
            errors.append(joint_errors(estimator(example.image), example.joints, seen))
        return summarise(errors, scale=512 / self._validation.camera.width)

    def averaged(self) -> PoseNetwork:
        """Return a network with the averaged weights."""
        network = PoseNetwork(self.network.architecture, self.network.limbs)
        network.load_state_dict(self._average)
        return network.eval()

    def save(self) -> None:
        """Write the checkpoint, and the averaged network as a weight file."""
        tensors = {f"network/{name}": value for name, value in self.network.state_dict().items()}
        tensors |= {f"average/{name}": value for name, value in self._average.items()}
        for name, parameter in self.network.named_parameters():
            for key, value in self._optimiser.state[parameter].items():
                tensors[f"optimiser/{name}/{key}"] = value
        header = {"frames": str(self.frames), "seconds": str(self.seconds)}
        write_weights(self.folder / CHECKPOINT, RUN_KIND, tensors, header)
        info = {"frames": self.frames, "seconds": round(self.seconds)}
        save_network(self.averaged(), self.folder / NETWORK, info)

    def _restore(self) -> None:
        header, tensors = read_weights(self.folder / CHECKPOINT, RUN_KIND, may_be_infinite=None)
        self.frames, self.seconds = int(header["frames"]), float(header["seconds"])
        parts: dict[str, dict[str, Tensor]] = {"network": {}, "average": {}, "optimiser": {}}
        for name, value in tensors.items():
            part, _, rest = name.partition("/")
            parts[part][rest] = value
        self.network.load_state_dict(parts["network"])
        self._average = parts["average"]
        parameters = dict(self.network.named_parameters())
        for name, value in parts["optimiser"].items():
            parameter, _, key = name.rpartition("/")
            self._optimiser.state[parameters[parameter]][key] = value

    def _batches(self) -> Iterator[list[Example]]:
        """Yield augmented pictures that depend only on the seed and the number of frames."""
        while True:
            random = np.random.default_rng([self.options.seed, self.frames])
            chosen = random.integers(0, len(self._data), self.options.batch)
            yield [
                augment(self._data[int(index)], self._size(), random, self.options.augmentation)
                for index in chosen
            ]

    def _size(self) -> tuple[int, int]:
        if self.frames < self.options.small_share * self.options.frames:
            return NETWORK_SIZE[0] * 3 // 4 // 8 * 8, NETWORK_SIZE[1] * 3 // 4
        return NETWORK_SIZE

    def _step(self, examples: list[Example]) -> float:
        options = self.options
        self.network.train()
        for group in self._optimiser.param_groups:
            group["lr"] = self._learning_rate()
        size, limbs = self._size(), self.network.limb_indices
        arrays = (
            [normalised(one.image, size)[0] for one in examples],
            [encode(one.joints, one.annotated, size, limbs) for one in examples],
            [loss_mask(one.annotated, one.boxes, size, limbs) for one in examples],
        )
        pictures, fields, mask = (torch.from_numpy(np.stack(rows)) for rows in arrays)
        pictures = pictures.to(memory_format=torch.channels_last)
        with torch.autocast("cpu", torch.bfloat16, enabled=options.bfloat16):
            stages = self.network(pictures, self._dropped())
        loss = field_loss([one.float() for one in stages], fields, mask, options.heat_weight)
        self._optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), 200.0)
        self._optimiser.step()
        self.frames += len(examples)
        self._take_average()
        return float(loss.detach())

    def _dropped(self) -> Tensor | None:
        random = np.random.default_rng([self.options.seed, self.frames, 1])
        limbs = len(self.network.limbs)
        if random.random() >= self.options.limb_dropout or limbs < 2:
            return None
        return torch.from_numpy(random.random(limbs) < random.uniform(0.2, 0.9))

    def _learning_rate(self) -> float:
        done = self.frames / self.options.frames
        if done < 0.02:
            return self.options.learning_rate * (0.05 + 0.95 * done / 0.02)
        return self.options.learning_rate * (0.01 + 0.99 * (1 + math.cos(math.pi * done)) / 2)

    def _take_average(self) -> None:
        # A short memory at first, because the initial weights carry no information.
        steps = self.frames / self.options.batch
        keep = min(self.options.average, (1 + steps) / (10 + steps))
        with torch.no_grad():
            for name, value in self.network.state_dict().items():
                if value.is_floating_point():
                    self._average[name].lerp_(value, 1 - keep)
                else:
                    self._average[name].copy_(value)

    def _note(self, loss: float, summary: PoseAccuracy) -> None:
        line: dict[str, Any] = {
            "frames": self.frames,
            "seconds": round(self.seconds, 1),
            "loss": round(loss, 3),
            "learning_rate": self._learning_rate(),
            "pck_0.2": round(summary.pck, 4),
            "error_px": round(summary.mean_pixels, 3),
            "detected": round(summary.detected, 4),
        }
        with open(self.folder / CURVE, "a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")


def read_curve(folder: Path) -> list[dict[str, float]]:
    """Return the evaluations of a run in temporal order."""
    path = folder / CURVE
    if not path.is_file():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
