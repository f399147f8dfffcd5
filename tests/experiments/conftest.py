"""Files of grids."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from tiny_grids import GridFile


@pytest.fixture
def grid_file(tmp_path: Path) -> GridFile:
    """A function (content) -> path of a grid file."""

    def write(content: dict[str, Any]) -> Path:
        path = tmp_path / "grid.yml"
        path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
        return path

    return write
