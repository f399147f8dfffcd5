"""On-policy algorithms that start as single-arm teachers, with normalised inputs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th
from stable_baselines3.common.logger import Logger

from saver_advisors.pretrained import load_teacher, side_by_side
from saver_advisors.safe_baselines import ALGORITHMS, CostConstrainedMixin, StartedPolicy
from saver_envs.envs.sb3_vec_env import SaverVecEnv

TEACHER = "jaco-pick-and-place"


def started(
    algorithm: type[CostConstrainedMixin], teacher: str | None = TEACHER, width: int = 256
) -> Any:
    model = algorithm(
        StartedPolicy,
        SaverVecEnv("DualJacoDistance-v0", 2, seed=0, max_episode_steps=10),
        n_steps=20,
        batch_size=20,
        policy_kwargs={"teacher": teacher, "net_arch": {"pi": [width] * 3, "vf": [16]}},
        seed=0,
        device="cpu",
    )
    model.set_logger(Logger(folder=None, output_formats=[]))
    return model


@pytest.mark.parametrize("algorithm", ALGORITHMS.values(), ids=ALGORITHMS)
def test_it_acts_as_the_teachers_then_learns_and_is_saved(
    algorithm: type[CostConstrainedMixin], tmp_path: Path
) -> None:
    model = started(algorithm)
    pair = side_by_side(load_teacher(TEACHER), 2)
    now: Any = model.env.reset()
    expected, _ = pair.predict(now)
    np.testing.assert_allclose(model.predict(now, deterministic=True)[0], expected, atol=1e-5)
    features = model.policy.features_extractor
    mean, of_teachers = features.mean.clone(), features.count > 0
    assert model.cost_critic.features_extractor is features
    model.learn(120)
    changed = model.predict(now, deterministic=True)[0]
    assert 0 < np.abs(changed - expected).max() < 0.5, "it has learned a little"
    th.testing.assert_close(features.mean[of_teachers], mean[of_teachers], rtol=1e-5, atol=1e-5)
    # The last input is the distance between the cubes; two rollouts were counted.
    assert not of_teachers[-1] and float(features.count[-1]) == 80
    assert float(features.mean[-1]) == pytest.approx(0.35, abs=0.02)
    model.save(tmp_path / "model")
    loaded = algorithm.load(tmp_path / "model", device="cpu")
    np.testing.assert_array_equal(loaded.predict(now, deterministic=True)[0], changed)


def test_without_a_teacher_it_starts_from_random_weights() -> None:
    model = started(ALGORITHMS["ppolag"], teacher=None)
    assert float(model.policy.features_extractor.count.max()) == 0
    action, _ = model.predict(model.env.reset(), deterministic=True)
    assert 0 < np.abs(action).max() < 0.1


def test_networks_that_cannot_hold_the_teachers_are_named() -> None:
    with pytest.raises(ValueError, match=r"use net_arch=\[256, 256, 256\]"):
        started(ALGORITHMS["ppolag"], width=128)
