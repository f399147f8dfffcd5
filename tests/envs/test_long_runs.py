"""Long runs; only in ``make test-long``."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from rollouts import ALL_IDS, SPARSE_IDS, assert_same, begun, random_actions

TOTAL_STEPS = 1_000_000
N = 64


@pytest.mark.long
@pytest.mark.parametrize("env_id", ALL_IDS)
def test_random_steps_stay_finite(env_id: str) -> None:
    """10^6 steps over all ids: no NaN, no divergence."""
    env = gymnasium.make_vec(env_id, num_envs=N, threads=2, autoreset_mode="SameStep")
    env.reset(seed=0)
    generator = np.random.default_rng(0)
    shape = env.action_space.shape
    for _ in range(-(-TOTAL_STEPS // (len(ALL_IDS) * N))):
        seen, reward, _, _, infos = env.step(generator.uniform(-1, 1, shape))
        assert all(np.isfinite(values).all() for values in seen.values())
        assert np.isfinite(reward).all()
        ended = infos.get("final_info", {})
        assert not infos["diverged"].any()
        assert not ended.get("diverged", np.zeros(1)).any()


@pytest.mark.long
@pytest.mark.parametrize("env_id", SPARSE_IDS)
def test_a_row_of_a_batch_is_an_episode_alone(env_id: str) -> None:
    """Every id, three seeds, 200 steps, bit for bit."""
    batch = begun(env_id, 3)
    alone = [begun(env_id, 1, seed) for seed in range(3)]
    for action in random_actions(batch.action_size, 200, 3):
        outcome = batch.step(action)
        singles = [one.step(action[[row]]) for row, one in enumerate(alone)]
        if outcome.truncated.any():
            rows = np.flatnonzero(outcome.truncated)
            batch.reset(rows)
            for row in rows:
                alone[row].reset()
        for row, one in enumerate(alone):
            assert outcome.info_of(row) == singles[row].info_of(0)
            for name, values in vars(batch.observation()).items():
                assert_same(values[[row]], getattr(one.observation(), name))
