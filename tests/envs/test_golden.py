"""Behaviour does not change unnoticed: golden trajectories, see ``golden.py``."""

from __future__ import annotations

import json

import numpy as np
import pytest
from golden import FOLDER, IDS, play


@pytest.mark.parametrize("env_id", IDS)
def test_golden_trajectory(env_id: str) -> None:
    stored, played = json.loads((FOLDER / f"{env_id}.json").read_text()), play(env_id)
    np.testing.assert_allclose(played["desired_goal"], stored["desired_goal"], rtol=0, atol=1e-6)
    for row, (now, then) in enumerate(
        zip(played["observations"], stored["observations"], strict=True)
    ):
        np.testing.assert_allclose(now, then, rtol=0, atol=1e-6, err_msg=f"observation {row}")


def test_every_file_has_its_id() -> None:
    assert {path.stem for path in FOLDER.glob("*.json")} == set(IDS)
