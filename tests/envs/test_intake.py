"""Intake: the bed conveys the person and stops; rails and hands are where the page says."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from rollouts import begun

from saver_envs.episodes import Episodes
from saver_envs.people.limp_people import PEOPLE, LimpPeople
from saver_envs.people.manikin import SIDES
from saver_envs.registration import make_episodes
from saver_envs.sensor_errors import SENSORS
from saver_envs.tasks.care_starts import posed_people, settled
from saver_envs.tasks.intake import ENTRANCE, GAP, OUTSIDE, SPEED, WAY
from saver_envs.tasks.limbs import POSITIONS, VELOCITIES

ENV_ID = "Intake-v0"
IDLE = np.zeros(6)


def goals(episodes: Episodes) -> NDArray[np.float64]:
    """Return travel and distance of the arm, by side, (n, 2, 2)."""
    achieved = episodes.observation().achieved_goal.astype(np.float64)
    return achieved.reshape(len(achieved), 2, 2)


def moved(episodes: Episodes, way: float) -> None:
    """Move the person of the first episode along x."""
    address = episodes.simulation.keep(LimpPeople).layout.root_qpos[0]
    episodes.simulation.qpos[0, address] += way
    episodes.simulation.refresh()
    episodes._read()


def test_the_bed_conveys_at_its_speed_and_stops_after_the_way() -> None:
    episodes = begun(ENV_ID, 1, bed_speed=0.2)
    np.testing.assert_array_equal(goals(episodes)[..., 0], 0.0)
    for _ in range(25):
        episodes.step(IDLE[None])
    assert goals(episodes)[..., 0] == pytest.approx(0.2, abs=0.01)
    episodes.memory["began"] += WAY - 0.2  # as if it had begun farther away
    for _ in range(5):
        episodes.step(IDLE[None])
    ended = goals(episodes)[..., 0]
    assert ended == pytest.approx(WAY, abs=0.02)
    for _ in range(5):
        episodes.step(IDLE[None])
    assert goals(episodes)[..., 0] == pytest.approx(ended, abs=2e-3)


def test_an_arm_is_outside_by_the_distance_of_its_wrist_or_elbow() -> None:
    episodes = begun(ENV_ID, 1)
    points = [
        [episodes.simulation.site_position[0, site] for site in sites]
        for sites in (
            [episodes.scene.model.site(f"joint_{side}_{one}").id for one in ("wrist", "elbow")]
            for side in SIDES
        )
    ]
    for arm, places in enumerate(points):
        farthest = max(
            np.hypot(max(x - ENTRANCE, 0.0), max(abs(y) - GAP / 2, 0.0)) for x, y, _ in places
        )
        assert goals(episodes)[0, arm, 1] == pytest.approx(farthest, abs=1e-5)
        assert farthest > 0.5
    moved(episodes, -2.5)
    beside = [max(max(abs(y) - GAP / 2, 0.0) for _, y, _ in places) for places in points]
    assert goals(episodes)[0, :, 1] == pytest.approx(beside, abs=1e-5)
    assert max(beside) > 0.0


def test_starts_have_speeds_of_the_range_and_people_of_all_kinds() -> None:
    episodes = begun(ENV_ID, 16)
    speed = episodes.memory["speed"]
    assert (speed >= SPEED[0]).all()
    assert (speed <= SPEED[1]).all()
    assert len(set(episodes.memory["who"].tolist())) > 3


def test_a_hand_lies_outside_of_the_rails_in_every_start() -> None:
    posed = posed_people(make_episodes(ENV_ID, 1).scene)
    for who in range(len(PEOPLE)):
        for pose in settled("intake")[who]:
            data = posed.posed(who, pose)
            wrists = [data.site(f"joint_{side}_wrist").xpos[1] for side in SIDES]
            assert np.abs(wrists).max() > GAP / 2 + OUTSIDE


def test_sensors_err_about_the_limbs() -> None:
    erring = {sensor.part for sensor in SENSORS}
    assert erring >= {part.name for part in (*POSITIONS, *VELOCITIES)}


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
