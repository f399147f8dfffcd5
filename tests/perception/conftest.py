"""One thread of torch, and small things that several tests share."""

from __future__ import annotations

import pytest
import torch

from saver_envs.cameras.rgbd import KINECT_V2
from saver_envs.perception.dataset import RenderedDataset, render
from saver_envs.perception.rendered_scenes import RenderedSceneOptions


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)
    torch.manual_seed(0)


@pytest.fixture(scope="session")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> RenderedDataset:
    """Six pictures of two people, 128 x 106, with depth."""
    folder = tmp_path_factory.mktemp("rendered")
    options = RenderedSceneOptions(people=2, arms=1.0, bench_share=0.5)
    render(folder, 6, 5, options, KINECT_V2.scaled(0.25), shard_size=3)
    return RenderedDataset(folder)
