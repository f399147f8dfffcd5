"""A run that learns, stops, goes on, and writes what it has."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from saver_envs.perception import training
from saver_envs.perception.augment import Augmentation
from saver_envs.perception.dataset import RenderedDataset
from saver_envs.perception.training import NETWORK, PoseTrainer, PoseTrainingOptions, read_curve
from saver_envs.perception.weights import load_network

ARMS = ("left_forearm", "left_upper_arm")
TINY = PoseTrainingOptions(
    limbs=ARMS,
    frames=18,
    batch=3,
    small_share=0.5,
    augmentation=Augmentation(),
    bfloat16=False,
)


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "NETWORK_SIZE", (64, 96))


def trained(folder: Path, data: RenderedDataset, stops: list[int]) -> PoseTrainer:
    """A trainer that was made anew after each of some numbers of frames."""
    for stop in [*stops, TINY.frames]:
        trainer = PoseTrainer(folder, data, data, TINY, measured=2)
        while trainer.frames < stop:
            trainer._step(next(trainer._batches()))
        trainer.save()
    return trainer


def test_a_run_that_was_interrupted_ends_like_one_that_was_not(
    rendered: RenderedDataset, tmp_path: Path
) -> None:
    straight = trained(tmp_path / "a", rendered, [])
    resumed = trained(tmp_path / "b", rendered, [9])
    for one, other in zip(straight.network.parameters(), resumed.network.parameters(), strict=True):
        assert torch.allclose(one, other, atol=1e-6)
    for name, value in straight.averaged().state_dict().items():
        assert torch.allclose(value, resumed.averaged().state_dict()[name], atol=1e-6)


def test_a_whole_run(rendered: RenderedDataset, tmp_path: Path) -> None:
    seen = []
    trainer = PoseTrainer(tmp_path, rendered, rendered, TINY, measured=2)
    trainer.run(measure_every=6, progress=lambda n, text: seen.append((n, text)))
    assert trainer.frames == TINY.frames == sum(n for n, _ in seen)
    curve = read_curve(tmp_path)
    assert [one["frames"] for one in curve] == [6, 12, 18]
    assert all(0.0 <= one["pck_0.2"] <= 1.0 for one in curve)
    network = load_network(tmp_path / NETWORK)
    assert set(network.limbs) == set(ARMS)
    other = PoseTrainingOptions(limbs=ARMS, frames=48)
    with pytest.raises(ValueError, match=r"other options: .*frames"):
        PoseTrainer(tmp_path, rendered, rendered, other)


def test_learning_lowers_the_loss_on_one_picture(rendered: RenderedDataset, tmp_path: Path) -> None:
    calm = Augmentation(
        rotation=0.0, scale=(1.0, 1.0), shift=0.0, mirror=0.0, noise=0.0, patches=0.0
    )
    options = PoseTrainingOptions(
        limbs=ARMS, frames=4000, batch=2, small_share=0.0, augmentation=calm, bfloat16=False,
        limb_dropout=0.0,
    )  # fmt: skip

    class One:
        def __len__(self) -> int:
            return 1

        def __getitem__(self, index: int):
            return rendered[0]

    trainer = PoseTrainer(tmp_path, One(), rendered, options)
    losses = [trainer._step(next(trainer._batches())) for _ in range(40)]
    assert np.mean(losses[-5:]) < 0.7 * np.mean(losses[:5])
