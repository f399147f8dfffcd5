"""Recorded episodes: an episode depends on its seed alone, and can be played again."""

from __future__ import annotations

import numpy as np
import pytest
from short_episodes import SEEDS, SHORT, assert_same, expert, recorded

from saver_advisors.advising import make_advisor
from saver_advisors.cli.policies import resolve
from saver_advisors.datasets.actors import AdvisedActor, NoisyActor
from saver_advisors.datasets.recorded_episodes import record_episodes
from saver_envs.envs.goal_env import SaverGoalEnv


def test_an_episode_played_again_from_seed_and_actions_is_the_same() -> None:
    options = {"randomization": "mild", "report_parameters": True}
    for episode in recorded(expert(**options), **options):
        env = SaverGoalEnv("JacoPush-v0", **SHORT, **options)
        seen, info = env.reset(seed=episode.seed)
        infos = [info]
        for step, action in enumerate(episode.actions):
            for key, values in seen.items():
                np.testing.assert_array_equal(values, episode.observations[key][step], strict=True)
            seen, reward, terminated, truncated, info = env.step(action)
            infos.append(info)
            assert reward == episode.rewards[step]
            assert terminated == episode.terminations[step]
            assert truncated == episode.truncations[step]
        for key, values in seen.items():
            np.testing.assert_array_equal(values, episode.observations[key][-1], strict=True)
        names = set(infos[0])
        assert names == set(episode.infos) >= {"is_success", "cost", "cost_collision", "parameters"}
        for name in names - {"parameters"}:
            assert [one[name] for one in infos] == episode.infos[name].tolist()
        for name, values in episode.infos["parameters"].items():
            assert_same(np.stack([one["parameters"][name] for one in infos]), values)


def test_noise_belongs_to_the_episode() -> None:
    together = recorded(NoisyActor(expert().predict, 0.7))
    alone = list(
        record_episodes(NoisyActor(expert().predict, 0.7), "JacoPush-v0", [SEEDS[2]], SHORT)
    )
    np.testing.assert_array_equal(together[2].actions, alone[0].actions)
    clean = recorded(expert())
    difference = np.stack(
        [one.actions - other.actions for one, other in zip(together, clean, strict=True)]
    )
    assert not np.array_equal(difference[0], difference[1])
    assert np.abs(together[0].actions).max() <= 1.0
    np.testing.assert_array_equal(
        recorded(NoisyActor(expert().predict, 0.0))[0].actions, clean[0].actions
    )


@pytest.mark.parametrize("noise", [-0.1, np.inf, np.nan])
def test_noise_out_of_range(noise: float) -> None:
    with pytest.raises(ValueError, match=f"noise={noise}"):
        NoisyActor(expert().predict, noise)


def test_advice_is_marked_by_arm() -> None:
    env_id = "DualJacoPush-v0"
    teacher = resolve("expert-uncoordinated", env_id, SHORT)
    advisor = make_advisor("mc-act", f"scripted:{env_id}", 10, n_arms=2, threshold=1.2)
    episodes = recorded(AdvisedActor(NoisyActor(expert(env_id).predict), advisor), env_id)
    marks = np.stack([one.infos["advised"] for one in episodes])
    assert marks.shape == (3, 7, 2)
    assert marks.dtype == bool
    assert not marks[:, 0].any()  # nothing is advised at the reset
    assert 0 < marks.any(axis=2).sum() <= 10
    for episode in episodes:
        seen = {key: rows[:-1] for key, rows in episode.observations.items()}
        taught = teacher(seen).reshape(-1, 2, 3)
        marked = episode.infos["advised"][1:]
        equal = np.isclose(taught, episode.actions.reshape(-1, 2, 3), atol=1e-6).all(axis=2)
        np.testing.assert_array_equal(equal, marked)


def test_no_seed() -> None:
    with pytest.raises(ValueError, match="at least one seed"):
        next(record_episodes(expert(), "JacoPush-v0", []))
