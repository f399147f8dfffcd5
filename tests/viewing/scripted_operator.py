"""Playbacks for tests, and an operator who does what an expert would."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from saver_advisors.cli.policies import resolve
from saver_advisors.datasets.recorded_episodes import RecordedEpisode
from saver_advisors.viewing.operator import KEYS
from saver_advisors.viewing.playback import Playback


def playback(
    env_id: str = "JacoPush-v0", *, policy: str = "expert", seed: int = 0, **more: Any
) -> Playback:
    """The playback of an environment; ``arm`` is moved by hand, the rest are its options."""
    arm = more.pop("arm", None)

    def policies(name: str) -> Any:
        return resolve(name, env_id, more)

    return Playback(env_id, more, policies, [policy, "random"], seed=seed, arm=arm)


def drag(shown: Playback, motion: np.ndarray) -> None:
    """Drag the handle as far as an action would move the hand."""
    operator, episodes = shown.operator, shown.episodes
    assert operator is not None
    scene, rule = episodes.scene, episodes.worlds.set_points
    points = episodes.set_point.copy()
    points[0, operator.arm] += motion * np.ravel(rule.longest)[0]
    operator.drag(scene.to_world(points)[0, operator.arm])


def type_keys(shown: Playback, motion: np.ndarray) -> None:
    """Press the keys of the directions in which an action would move the hand (arms in a row)."""
    for axis, amount in enumerate(motion):
        if abs(amount) > 0.3:
            wanted = np.sign(amount) * np.eye(3)[axis]
            shown.press(next(key for key, way in KEYS.items() if (way == wanted).all()))


def demonstrations(shown: Playback, hand: Any = drag) -> Iterator[RecordedEpisode]:
    """Demonstrate by an expert's advice, episode after episode."""
    expert = shown._policies("expert")
    assert shown.operator is not None
    while True:
        if not shown.over:
            blocks = expert(shown.observation).reshape(shown.episodes.task.n_arms, -1)
            block = blocks[shown.operator.arm]
            hand(shown, block[:3])
            if len(block) > 3:
                shown.operator.grip(is_open=block[3] > 0)
            if not shown.operator.acts:  # nothing is left to do, and time would wait
                shown.press("enter")
        if (episode := shown.tick()) is not None:
            yield episode
