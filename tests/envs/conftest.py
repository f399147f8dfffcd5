"""Settings of all tests of the environments."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# Before MuJoCo is imported: without a display its default, GLFW, ends the whole process.
if sys.platform == "linux" and not {"DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ):
    os.environ.setdefault("MUJOCO_GL", "egl")

# The same examples in every run: what is red today was not green by luck yesterday.
settings.register_profile(
    "saver",
    derandomize=True,
    deadline=None,
    max_examples=25,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
settings.load_profile("saver")


@pytest.fixture(autouse=True)
def own_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run elsewhere: MuJoCo writes its warnings into the working directory."""
    monkeypatch.chdir(tmp_path)
