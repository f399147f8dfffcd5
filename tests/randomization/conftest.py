"""Settings of the tests of worlds that vary."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

# Before MuJoCo is imported: without a display its default, GLFW, ends the whole process.
if sys.platform == "linux" and not {"DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ):
    os.environ.setdefault("MUJOCO_GL", "egl")


@pytest.fixture(autouse=True)
def own_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run elsewhere: MuJoCo writes its warnings into the working directory."""
    monkeypatch.chdir(tmp_path)
