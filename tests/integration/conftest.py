"""The loop on the dual push scene."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from small_loops import SmallLoop, build_loop


@pytest.fixture
def make_loop() -> Callable[..., SmallLoop]:
    """Build a loop round a policy."""
    return build_loop
