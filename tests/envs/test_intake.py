"""Intake: the bed conveys the person and stops; rails and hands are where the page says."""

from __future__ import annotations

import numpy as np
import pytest
from rollouts import begun

from saver_envs.registration import make_episodes
from saver_envs.tasks.intake import SPEED, WAY

ENV_ID = "Intake-v0"
IDLE = np.zeros(6)


def test_the_bed_conveys_at_its_speed_and_stops_after_the_way() -> None:
    episodes = begun(ENV_ID, 2, bed_speed=0.2)
    before = episodes.observation().achieved_goal.copy()
    np.testing.assert_array_equal(before, 0.0)
    for _ in range(50):
        episodes.step(np.tile(IDLE, (2, 1)))
    travelled = episodes.observation().achieved_goal
    assert travelled == pytest.approx(0.2 * 2.0, abs=0.01)
    # The whole way takes 9 s; a second later the person lies still.
    for _ in range(200):
        episodes.step(np.tile(IDLE, (2, 1)))
    ended = episodes.observation().achieved_goal.copy()
    for _ in range(10):
        episodes.step(np.tile(IDLE, (2, 1)))
    assert ended == pytest.approx(WAY, abs=0.02)
    assert episodes.observation().achieved_goal == pytest.approx(ended, abs=2e-3)


def test_starts_have_speeds_of_the_range_and_people_of_all_kinds() -> None:
    episodes = begun(ENV_ID, 16)
    speed = episodes.memory["speed"]
    assert (speed >= SPEED[0]).all()
    assert (speed <= SPEED[1]).all()
    assert len(set(episodes.memory["who"].tolist())) > 3


def test_a_hand_that_presses_on_the_rail_collides() -> None:
    episodes = make_episodes(ENV_ID, 1)
    episodes.reset()
    costs = 0.0
    for _ in range(60):  # arm 0 inwards and down onto its rail's flare
        outcome = episodes.step(np.array([[-1.0, 0.35, -1.0, 0.0, 0.0, 0.0]]))
        costs += float(outcome.measured["cost_collision"][0])
    assert costs > 0


@pytest.mark.parametrize("speed", [0.0, 0.01, 0.3])
def test_speeds_out_of_range_are_refused(speed: float) -> None:
    with pytest.raises(ValueError, match="bed_speed"):
        make_episodes(ENV_ID, 1, bed_speed=speed)


def test_it_needs_two_arms() -> None:
    with pytest.raises(ValueError, match="n_arms=1"):
        make_episodes(ENV_ID, 1, n_arms=1)
