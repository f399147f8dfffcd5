"""The wheel of this checkout and an environment with it, made once."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))

import fresh_install


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fresh_install.build(tmp_path_factory.mktemp("dist"))


@pytest.fixture(scope="session")
def base_programs(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The programs of an environment with the wheel and no extra."""
    return fresh_install.install("base", wheel, tmp_path_factory.mktemp("base") / "venv")
