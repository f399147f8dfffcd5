"""Episodes that are watched, disturbed and demonstrated."""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scripted_operator import demonstrations, drag, playback, type_keys

from saver_advisors.datasets.minari_files import write_minari
from saver_advisors.datasets.recorded_episodes import RecordedEpisode, record_episodes
from saver_advisors.viewing.playback import HOLD, Playback, watch
from saver_envs.envs.goal_env import SaverGoalEnv


def play_on(shown: Playback) -> RecordedEpisode:
    """The next episode that ends."""
    return next(one for one in iter(shown.tick, "never") if one is not None)


def assert_repeats(episode: RecordedEpisode, env_id: str, **options: Any) -> None:
    """Play an episode again from its seed and actions: every number is the same."""
    env = SaverGoalEnv(env_id, **options)
    seen, info = env.reset(seed=episode.seed)
    for step in range(len(episode) + 1):
        for name, rows in episode.observations.items():
            np.testing.assert_array_equal(seen[name], rows[step], strict=True)
        assert set(info) == set(episode.infos)
        for name, values in episode.infos.items():
            np.testing.assert_array_equal(info[name], values[step])
        if step < len(episode):
            seen, reward, _, truncated, info = env.step(episode.actions[step])
            assert np.float32(reward) == episode.rewards[step]
            assert truncated == episode.truncations[step]
    env.close()


def test_it_plays_what_an_evaluation_plays() -> None:
    from saver_advisors.datasets.actors import Actor

    shown = playback("DualJacoPush-v0", seed=3, max_episode_steps=6)
    actor = Actor(shown._policies("expert"))
    recorded = record_episodes(actor, "DualJacoPush-v0", [3, 4], {"max_episode_steps": 6})
    for wanted in recorded:
        episode = play_on(shown)
        assert episode.seed == wanted.seed
        np.testing.assert_array_equal(episode.actions, wanted.actions, strict=True)
        np.testing.assert_array_equal(
            episode.observations["observation"], wanted.observations["observation"], strict=True
        )
        assert set(episode.infos) == set(wanted.infos)


@pytest.mark.parametrize("hand", [drag, type_keys])
def test_demonstrations_repeat_exactly(hand: Any, sets: Path) -> None:
    minari = pytest.importorskip("minari")
    shown = playback(arm=0, seed=20)
    episodes = list(islice(demonstrations(shown, hand), 2))
    assert [one.seed for one in episodes] == [20, 21]
    for episode in episodes:
        assert np.abs(episode.actions).max() > 0.5
        assert_repeats(episode, "JacoPush-v0")
    about = {"algorithm": "by hand", "description": "Of a test.", "about": {}}
    write_minari("saver/by-hand-v0", episodes, "JacoPush-v0", {}, **about)
    dataset = minari.load_dataset("saver/by-hand-v0")
    for read, made in zip(dataset.iterate_episodes(), episodes, strict=True):
        np.testing.assert_array_equal(read.actions, made.actions, strict=True)
        for name, rows in made.observations.items():
            np.testing.assert_array_equal(read.observations[name], rows, strict=True)


def test_an_operator_can_do_the_task() -> None:
    shown = playback("JacoPickAndPlace-v0", arm=0)
    episodes = list(islice(demonstrations(shown), 3))
    assert sum(one.success for one in episodes) >= 2
    assert shown.successes == sum(one.success for one in episodes)


def test_the_other_arm_is_the_policys() -> None:
    shown = playback("DualJacoPush-v0", arm=0, max_episode_steps=5)
    expert = shown._policies("expert")
    shown.waits = False
    first = expert(shown.observation)
    episode = play_on(shown)
    np.testing.assert_array_equal(episode.actions[0, 3:], first[0, 3:])
    np.testing.assert_allclose(episode.actions[:, :3], 0.0, atol=1e-6)


def test_time_waits_for_the_operator() -> None:
    shown = playback(arm=0, max_episode_steps=4)
    for _ in range(3):
        assert shown.tick() is None
    assert "action 0 of 4" in shown.status()["Episode"]
    shown.press("arrowleft")
    for _ in range(3):
        shown.tick()
    assert "action 1 of 4" in shown.status()["Episode"]
    shown.press("enter")
    assert len(play_on(shown)) == 4
    assert shown.over


def test_time() -> None:
    shown = playback(seed=5, max_episode_steps=4)
    shown.later(lambda: shown.press("space"))
    assert shown.tick() is None
    assert shown.paused
    shown.single_step()
    shown.tick()
    shown.tick()
    assert shown.status()["Episode"] == "seed 5, action 1 of 4"
    shown.press("home")
    assert shown.status()["Episode"] == "seed 5, action 0 of 4"
    shown.press("end")
    assert shown.status()["Episode"] == "seed 6, action 0 of 4"
    shown.press("space")
    play_on(shown)
    assert "over (failed)" in shown.status()["Episode"]
    for _ in range(HOLD):
        shown.tick()
    assert shown.seed == 7
    assert shown.status()["Played"] == "1, 0 with success"
    shown.choose("random")
    assert shown.policy == "random"


def test_a_push_moves_things_and_ends() -> None:
    shown = playback(policy="random", max_episode_steps=30)
    assert set(shown.bodies()) == {"object0", "hand 0"}
    shown._predict = lambda observation: np.zeros((1, 3), np.float32)
    start = shown.observation["achieved_goal"].copy()
    shown.push("object0", 5.0)
    assert "Pushed" in shown.status()
    for _ in range(10):
        shown.tick()
    assert np.linalg.norm(shown.observation["achieved_goal"] - start) > 0.03
    assert not shown.episodes.simulation.applied_force.any()
    shown.push("hand 0", 5.0)
    shown.press("home")
    assert not shown.disturbed
    assert not shown.episodes.simulation.applied_force.any()
    assert_repeats(play_on(shown), "JacoPush-v0", max_episode_steps=30)


class Watched:
    """A view that is closed after some pictures."""

    def __init__(self, pictures: int) -> None:
        self.left = pictures

    def show(self) -> bool:
        self.left -= 1
        return self.left >= 0

    def close(self) -> None:
        pass


def test_watching_ends_with_the_view_or_a_request() -> None:
    shown = playback(max_episode_steps=3)
    assert [one.seed for one in watch(shown, Watched(4 + HOLD + 3), lambda: False, 1e6)] == [0, 1]
    shown = playback(max_episode_steps=3)
    assert list(watch(shown, Watched(100), lambda: shown.played == 1, 1e6))[-1].seed == 0
