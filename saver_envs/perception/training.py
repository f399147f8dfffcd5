"""Training of a pose network: batches, optimiser, average of weights, checkpoints, curve."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from saver_envs.files import written_whole
from saver_envs.perception.augment import Augmentation, augment
from saver_envs.perception.dataset import Dataset, Example, RenderedDataset
from saver_envs.perception.estimator import NETWORK_SIZE, PoseEstimator, normalised
from saver_envs.perception.fields import encode, loss_mask
from saver_envs.perception.metrics import Summary, joint_errors, summarise
from saver_envs.perception.network import ARCHITECTURES, PoseNetwork, field_loss
from saver_envs.perception.weights import save_network

CHECKPOINT: Final = "checkpoint.safetensors"
CURVE: Final = "curve.jsonl"
NETWORK: Final = "network.safetensors"


@dataclass(frozen=True)
class TrainingOptions:
    """How a network is trained.

    :param architecture: ``light`` or ``vgg19``.
    :param limbs: whose branches are trained, all 13 where ``None``.
    :param frames: pictures in all, with repetition.
    :param batch: pictures a step.
    :param learning_rate: at its highest; it rises over the first 2% and falls as a cosine.
    :param weight_decay: decoupled.
    :param heat_weight: of joints against limbs in the loss.
    :param small_share: share of the run, from its beginning, that learns from pictures of 3/4 of
        the size, at half the cost.
    :param average: how much of the averaged weights stays at each step.
    :param limb_dropout: probability that stage 2 does not see stage 1's fields of some limbs, so
        that it works where only some limbs are run.
    :param bfloat16: compute in 16 bits, twice as fast where the processor can.
    :param seed: of everything.
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


def batch_tensors(
    examples: Sequence[Example], limbs: Sequence[int], size: tuple[int, int]
) -> tuple[Tensor, Tensor, Tensor]:
    """Return pictures (n, 3, h, w), fields (n, limbs, 3, h/8, w/8) and mask (n, limbs, h/8, w/8).

    :param examples: with pictures of ``size``.
    :param limbs: indices into :data:`~.skeleton.LIMBS`.
    :param size: height and width.
    """
    pictures = np.stack([normalised(one.image, size)[0] for one in examples])
    fields = np.stack([encode(one.joints, one.annotated, size, limbs) for one in examples])
    masks = np.stack([loss_mask(one.annotated, one.boxes, size, limbs) for one in examples])
    return torch.from_numpy(pictures), torch.from_numpy(fields), torch.from_numpy(masks)


class Trainer:
    """One run in one folder; made anew on the same folder it goes on.

    :param folder: for checkpoint, curve and network.
    :param data: to learn from.
    :param validation: rendered pictures to measure with, at most ``measured`` of them.
    :param options: of the run.
    :param measured: pictures of each measurement.
    :raises ValueError: where the folder holds a run with other options.
    """

    def __init__(
        self,
        folder: Path,
        data: Dataset,
        validation: RenderedDataset,
        options: TrainingOptions = TrainingOptions(),
        measured: int = 120,
    ) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.options = folder, options
        self._data, self._validation, self._measured = data, validation, measured
        _check_options(folder, options)
        torch.manual_seed(options.seed)
        self.network = PoseNetwork(ARCHITECTURES[options.architecture], options.limbs)
        # Channels last is the faster order on processors.
        self.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self._optimiser = torch.optim.AdamW(
            self.network.parameters(), lr=options.learning_rate, weight_decay=options.weight_decay
        )
        self._average = {name: value.clone() for name, value in self._state().items()}
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
        """Train to the end, or for a while.

        :param until: seconds, after which the run stops with a checkpoint.
        :param checkpoint_every: seconds.
        :param measure_every: frames between two measurements on the validation pictures.
        :param progress: told the number of frames and a line of text after each step.
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

    def measure(self) -> Summary:
        """Return how well the averaged weights do on the validation pictures."""
        estimator = PoseEstimator(self.averaged())
        errors = []
        for index in range(min(self._measured, len(self._validation))):
            example = self._validation[index]
            poses = estimator(example.image)
            errors.append(joint_errors(poses, example.joints, self._validation.visibility(index)))
        return summarise(errors, scale=512 / self._validation.camera.width)

    def averaged(self) -> PoseNetwork:
        """Return a network with the averaged weights."""
        network = PoseNetwork(self.network.architecture, self.network.limbs)
        network.load_state_dict(self._average)
        return network.eval()

    def save(self) -> None:
        """Write the checkpoint, and the averaged network as a weight file."""
        from safetensors.torch import save as to_bytes

        tensors = {f"network/{name}": value for name, value in self._state().items()}
        tensors |= {f"average/{name}": value for name, value in self._average.items()}
        names = [name for name, _ in self.network.named_parameters()]
        for name, parameter in zip(names, self.network.parameters(), strict=True):
            for key, value in self._optimiser.state[parameter].items():
                tensors[f"optimiser/{name}/{key}"] = value
        tensors = {name: value.detach().clone().contiguous() for name, value in tensors.items()}
        metadata = {"frames": str(self.frames), "seconds": str(self.seconds)}
        with written_whole(self.folder / CHECKPOINT) as file:
            file.write(to_bytes(tensors, metadata))
        info = {"frames": self.frames, "seconds": round(self.seconds)}
        save_network(self.averaged(), self.folder / NETWORK, info)

    def _restore(self) -> None:
        from safetensors import safe_open

        with safe_open(self.folder / CHECKPOINT, "pt") as file:
            metadata = file.metadata()
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        self.frames, self.seconds = int(metadata["frames"]), float(metadata["seconds"])
        parts: dict[str, dict[str, Tensor]] = {"network": {}, "average": {}}
        for name, value in tensors.items():
            part, _, rest = name.partition("/")
            if part in parts:
                parts[part][rest] = value
        self.network.load_state_dict(parts["network"])
        self._average = parts["average"]
        for name, parameter in self.network.named_parameters():
            start = f"optimiser/{name}/"
            state = {
                key.removeprefix(start): tensors[key] for key in tensors if key.startswith(start)
            }
            if state:
                self._optimiser.state[parameter] = state

    def _state(self) -> dict[str, Tensor]:
        state: dict[str, Tensor] = self.network.state_dict()
        return state

    def _batches(self) -> Iterator[list[Example]]:
        """Yield augmented pictures; what comes after so many frames depends on the seed alone."""
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
        size = self._size()
        pictures, fields, mask = batch_tensors(examples, self.network.limb_indices, size)
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
        # Early on, a short memory: the first weights are worth nothing.
        steps = self.frames / self.options.batch
        keep = min(self.options.average, (1 + steps) / (10 + steps))
        with torch.no_grad():
            for name, value in self._state().items():
                if value.is_floating_point():
                    self._average[name].lerp_(value, 1 - keep)
                else:
                    self._average[name].copy_(value)

    def _note(self, loss: float, summary: Summary) -> None:
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


def _check_options(folder: Path, options: TrainingOptions) -> None:
    wanted = json.loads(json.dumps(asdict(options)))
    path = folder / "options.json"
    if not path.is_file():
        path.write_text(json.dumps(wanted, indent=2) + "\n", encoding="utf-8")
        return
    found = json.loads(path.read_text(encoding="utf-8"))
    other = sorted(name for name in wanted if found.get(name) != wanted[name])
    if other:
        raise ValueError(f"{folder} holds a run with other options: {', '.join(other)}")


def read_curve(folder: Path) -> list[dict[str, float]]:
    """Return the measurements of a run, the earliest first."""
    path = folder / CURVE
    if not path.is_file():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
