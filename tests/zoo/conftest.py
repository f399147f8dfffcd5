"""One thread, as everywhere."""

from __future__ import annotations

import pytest
import torch
from zoo_runs import models

__all__ = ["models"]


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)
