"""Puts this folder on the path, for the helpers that several folders of tests share."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture
def sets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder that Minari reads from, which does not exist yet."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "sets"))
    return tmp_path / "sets"
