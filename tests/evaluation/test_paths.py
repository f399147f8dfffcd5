"""An episode in space and time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from saver_advisors.evaluation.episodes import evaluate_policy
from saver_advisors.reporting.episode_paths import draw_paths, follow

DISTANCE = "DualJacoDistance-v0"


def still(size: int) -> Any:
    return lambda observation: np.zeros((len(observation["observation"]), size))


def test_paths_are_those_of_the_evaluated_episode() -> None:
    def apart(observation: Any) -> np.ndarray:
        action = np.zeros((len(observation["observation"]), 8))
        action[:, 2], action[:, 6] = 1.0, -1.0  # one hand up, one down
        return action

    kwargs = {"max_episode_steps": 20}
    paths = follow(apart, DISTANCE, title="apart", seed=3, env_kwargs=kwargs)
    assert paths.hands.shape == paths.objects.shape == (21, 2, 3)
    assert paths.seconds[-1] == pytest.approx(0.8)
    assert paths.hands[-1, 0, 2] > paths.hands[0, 0, 2] + 0.1
    assert paths.band == pytest.approx((0.335, 0.365))
    outcomes = evaluate_policy(apart, DISTANCE, episodes=1, seed=3, env_kwargs=kwargs)
    assert outcomes.deviations is not None
    worst = np.abs(paths.distances[1:] - 0.35).max()
    assert worst == pytest.approx(outcomes.deviations[0, 1], abs=1e-6)
    final = np.linalg.norm(paths.objects[-1] - paths.targets, axis=-1)
    np.testing.assert_allclose(final, outcomes.final_distances[0], atol=1e-6)


def test_without_a_constraint_there_is_no_band(tmp_path: Path) -> None:
    paths = follow(still(6), "DualJacoPush-v0", title="push", env_kwargs={"max_episode_steps": 3})
    assert paths.band is None
    draw_paths([paths]).savefig(tmp_path / "paths.png")
    assert (tmp_path / "paths.png").stat().st_size > 10_000


def test_one_arm_has_no_distance() -> None:
    paths = follow(still(3), "JacoPush-v0", title="alone", env_kwargs={"max_episode_steps": 2})
    with pytest.raises(ValueError, match="no distance"):
        draw_paths([paths])
