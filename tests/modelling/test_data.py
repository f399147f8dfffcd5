"""Trajectories, the twin, and the way from a run to a data file and back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from saver_envs.modelling import datasets
from saver_envs.modelling.arms import arm_named
from saver_envs.modelling.arms.description import Campaign
from saver_envs.modelling.arms.mico import TWIN
from saver_envs.modelling.datasets import (
    COLUMNS,
    Recording,
    campaign_of,
    load_recordings,
    record_twin,
    samples_of,
    save_recordings,
    simulated_steps,
    smoothed,
    twin_data_set,
)
from saver_envs.modelling.dynamics import tracking_error
from saver_envs.modelling.trajectories import Trajectory, random_trajectory
from saver_envs.modelling.twin import (
    TIME_STEP,
    Twin,
    nominal_inverse_dynamics,
    nominal_model,
)

SHORT = Campaign(2, 2, 1.0, 1, cut=0.5, window=50, keep_every=10)


def recording(samples: int = 20, dof: int = 4) -> Recording:
    values = np.random.default_rng(0).normal(size=(samples, 4 * dof + 3))
    return Recording(*np.split(values, [dof, 2 * dof, 3 * dof, 4 * dof], axis=1))


def test_cubics_rest_at_the_way_points_and_agree_with_their_derivatives() -> None:
    points = np.array([[0.0, 1.0], [1.0, -1.0], [0.5, 2.0]])
    trajectory = Trajectory(points, 8.0)
    position, velocity, _ = trajectory.at(np.array([0.0, 8.0, 16.0]))
    assert np.allclose(position, points)
    assert np.allclose(velocity, 0)
    times = np.linspace(0.1, 7.9, 50)
    step = 1e-5
    before, after = trajectory.at(times - step), trajectory.at(times + step)
    _, velocity, acceleration = trajectory.at(times)
    assert np.allclose((after[0] - before[0]) / (2 * step), velocity, atol=1e-6)
    assert np.allclose((after[1] - before[1]) / (2 * step), acceleration, atol=1e-6)


@pytest.mark.parametrize("name", ["mico", "fetch"])
def test_way_points_are_feasible(name: str) -> None:
    arm, interval = arm_named(name), campaign_of(name).interval
    trajectory = random_trajectory(name, 12, interval, np.random.default_rng(1))
    assert (trajectory.points >= arm.lower).all()
    assert (trajectory.points <= arm.upper).all()
    position, velocity, _ = trajectory.at(np.arange(0, trajectory.duration, 0.05))
    # It is checked at points on the way: between them it may dip by little.
    assert arm.chain.position(position)[:, 2].min() > 0.19
    assert (np.abs(velocity) <= np.asarray(arm.robot.joint_speed_limits) + 1e-9).all()
    again = random_trajectory(name, 12, interval, np.random.default_rng(1))
    assert np.array_equal(trajectory.points, again.points)


def test_campaigns_give_the_papers_sizes() -> None:
    mico, fetch = campaign_of("mico"), campaign_of("fetch")
    assert (mico.trajectories, mico.way_points * mico.interval) == (6, 800)
    assert fetch.trajectories == 2
    assert fetch.way_points * fetch.interval - 2 * fetch.cut == 2400
    for campaign, samples in ((mico, 12_000), (fetch, 60_000)):
        logged = campaign.way_points * campaign.interval / (TIME_STEP * campaign.log_every)
        cut = 2 * campaign.cut / (TIME_STEP * campaign.log_every)
        assert (logged - cut) / campaign.keep_every == samples
    assert simulated_steps("mico") == 400_000


def test_the_twin_differs_from_the_makers_arm_as_its_parameters_say() -> None:
    nominal, twin = nominal_model("mico"), Twin("mico").model
    ratio = twin.body("link_2").mass[0] / nominal.body("link_2").mass[0]
    assert ratio == pytest.approx(TWIN.mass_scale[1])
    assert np.allclose(twin.dof_frictionloss, TWIN.friction)
    assert np.allclose(twin.actuator_forcerange[:, 1], TWIN.torque_limit)


def test_feed_forward_of_the_plants_own_dynamics_tracks_best() -> None:
    ways = [Trajectory(np.array([[0.0, 2.2, 4.0, 0.0], [0.5, 2.6, 3.4, 0.5]]), 3.0)]
    given = TWIN
    still = (0.0,) * 4
    ideal = replace(
        given,
        mass_scale=(1.0,) * 4,
        centre_shift=(0.0, 0.0, 0.0),
        friction=still,
        damping=still,
        encoder_noise=still,
        velocity_noise=still,
        lag=1e-6,
    )
    dynamics = nominal_inverse_dynamics("mico")

    def of_the_ideal(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        return dynamics(q, v, a) + np.asarray(given.armature) * a

    exact = tracking_error(Twin("mico", ideal), ways, of_the_ideal)
    assert exact.rms < 2e-4
    alone = tracking_error(Twin("mico", ideal), ways, None)
    assert alone.rms > 20 * exact.rms
    real = tracking_error(Twin("mico"), ways, dynamics)
    assert exact.rms < real.rms < 0.02
    with pytest.raises(ValueError, match="gain=0"):
        tracking_error(Twin("mico"), ways, None, gain=0)


def test_torques_saturate() -> None:
    weak = replace(TWIN, torque_limit=(1.0, 1.0, 1.0, 1.0))
    ways = [Trajectory(np.array([[0.0, 2.2, 4.0, 0.0], [2.0, 2.6, 3.4, 0.5]]), 1.0)]
    record = Twin("mico", weak).track(ways, None, np.random.default_rng(0))
    assert 0.9 < np.abs(record.measured_torque).max() < 1.0 + 6 * 0.05


def test_runs_are_reproducible_from_their_seed() -> None:
    first, again = (record_twin("mico", SHORT, 3) for _ in range(2))
    other = record_twin("mico", SHORT, 4)
    for column in COLUMNS:
        assert np.array_equal(getattr(first[0], column), getattr(again[0], column))
        assert not np.array_equal(getattr(first[0], column), getattr(other[0], column))
        assert not np.array_equal(getattr(first[0], column), getattr(first[1], column))
    hand = arm_named("mico").chain.position(first[0].position)
    assert np.array_equal(hand, first[0].hand)


@pytest.mark.parametrize("window", [10, 11])
def test_smoothing_keeps_lines_and_removes_noise(window: int) -> None:
    line = np.arange(200.0)[:, None] * np.array([1.0, -2.0])
    inner = slice(40, -40)
    assert np.allclose(smoothed(line, window, 3)[inner], line[inner])
    noise = np.random.default_rng(0).normal(size=(5000, 1))
    assert smoothed(noise, window).std() < 1.2 / np.sqrt(window)
    assert smoothed(line, window).shape == line.shape


def test_velocities_and_accelerations_are_those_of_the_motion() -> None:
    from saver_envs.modelling.datasets import process
    from saver_envs.modelling.twin import Record

    time = np.arange(0, 8, TIME_STEP)
    swing = 0.5 * np.sin(0.5 * time)[:, None] * np.ones(4) + 2.0
    still = np.zeros_like(swing)[None]
    record = Record(still, still, swing[None], still + 1.5)
    campaign = Campaign(1, 1, 8.0, 1, cut=1.0, window=50, keep_every=32)
    found = process(record, arm_named("mico").chain, campaign)[0]
    kept = time[500:-500:32][: len(found)]
    assert np.abs(found.velocity[:, 0] - 0.25 * np.cos(0.5 * kept)).max() < 1e-3
    assert np.abs(found.acceleration[:, 0] + 0.125 * np.sin(0.5 * kept)).max() < 1e-3
    assert np.allclose(found.torque, 1.5)


def test_files_come_back_as_they_were(tmp_path: Path) -> None:
    path = tmp_path / "mico.npz"
    save_recordings(path, "mico", [recording(), recording()])
    again = load_recordings(path, "mico")
    assert len(again) == 2
    for column in COLUMNS:
        assert np.array_equal(getattr(again[1], column), getattr(recording(), column))
    assert [one.name for one in tmp_path.iterdir()] == ["mico.npz"]


def test_data_sets_are_made_once_and_kept_in_the_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = []

    def fake(name: str, *_: object) -> list[Recording]:
        made.append(name)
        return [recording(), recording(), recording()]

    monkeypatch.setattr(datasets, "record_twin", fake)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    first, again = twin_data_set("mico"), twin_data_set("mico")
    assert made == ["mico"]
    assert (len(first.train), len(first.test)) == (40, 20)
    assert np.array_equal(first.train.torque, again.train.torque)
    inputs, outputs = samples_of(first.train, "id")
    assert (inputs.shape, outputs.shape) == ((40, 12), (40, 4))
    with pytest.raises(ValueError, match="robot='jaco'"):
        twin_data_set("jaco")


def test_the_first_samples_are_consecutive() -> None:
    whole = recording(50)
    assert np.array_equal(whole.first(10).torque, whole.torque[:10])
    with pytest.raises(ValueError, match="count=51"):
        whole.first(51)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"torque": None}, "lacks the columns torque"),
        ({"position": np.full((2, 20, 4), np.nan)}, r"position\[0, 0, 0\] is not finite"),
        ({"velocity": np.zeros((2, 20, 8))}, r"velocity has shape .*mico needs"),
        ({"hand": np.zeros((2, 19, 3))}, "hand has"),
        ({"robot": np.array("fetch")}, "of robot 'fetch', not 'mico'"),
    ],
)
def test_bad_files_are_refused(
    tmp_path: Path, change: dict[str, np.ndarray | None], message: str
) -> None:
    content: dict[str, np.ndarray] = {
        column: np.stack([getattr(recording(), column)] * 2) for column in COLUMNS
    }
    content["robot"] = np.array("mico")
    for name, value in change.items():
        if value is None:
            del content[name]
        else:
            content[name] = value
    path = tmp_path / "data.npz"
    np.savez(path, **content)
    with pytest.raises(ValueError, match=message):
        load_recordings(path, "mico")


def test_files_cut_short_or_pickled_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "mico.npz"
    save_recordings(path, "mico", [recording()])
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match="not a complete data file"):
        load_recordings(path, "mico")
    np.savez(path, position=np.array([{"an": "object"}], dtype=object))
    with pytest.raises(ValueError, match=r"file: not an \.npz of numbers"):
        load_recordings(path, "mico")
