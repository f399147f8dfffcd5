"""Make the examples of docs/examples importable, and forget what they registered."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import gymnasium
import pytest

from saver_envs.registration import ENVIRONMENTS, PIXELS
from saver_envs.robots import ROBOTS

EXAMPLES = Path(__file__).resolve().parents[2] / "docs" / "examples"


@pytest.fixture(scope="module", autouse=True)
def unregistered() -> Iterator[None]:
    """Leave no id or robot behind: other tests go through all that are registered."""
    tables: list[dict] = [ENVIRONMENTS, PIXELS, ROBOTS, gymnasium.registry]  # type: ignore[type-arg, list-item]
    before = [dict(table) for table in tables]
    sys.path.insert(0, str(EXAMPLES))
    yield
    sys.path.remove(str(EXAMPLES))
    for table, content in zip(tables, before, strict=True):
        table.clear()
        table.update(content)
    for name in ("own_robot", "own_task"):
        sys.modules.pop(name, None)
