"""Stages in processes: one is killed in the midst of a trial, the arms hold, it comes back."""

from __future__ import annotations

import json
import os
import signal
from dataclasses import replace

import numpy as np
import pytest

from saver_advisors.integration.assembly import LoopSettings, build_loop, build_stage
from saver_advisors.integration.bench import BenchGeometry, EpisodesBench
from saver_advisors.integration.health import Health
from saver_advisors.integration.messages import UNSTAMPED, Picture, PixelPose
from saver_advisors.integration.safety import SafetyLimits
from saver_advisors.integration.stage import Inputs, Mailbox
from saver_advisors.integration.supervisor import SILENT_PERIODS, ProcessLoop
from saver_advisors.integration.wire import Wire
from saver_envs.cameras.rgbd import KINECT_V2, CameraPose
from saver_envs.registration import make_episodes

SETTINGS = LoopSettings(
    seeing=False,
    learned_kinematics=False,
    limits=SafetyLimits(max_speed=0.5, clearance=0.0),
    silent_periods=SILENT_PERIODS,
)
#: Simulated seconds within which a process must be back; it begins in a few real ones.
PATIENCE = 60.0


@pytest.mark.slow
def test_a_killed_process_is_held_for_and_comes_back() -> None:
    bench = EpisodesBench(make_episodes("DualMicoPush-v0"))
    with ProcessLoop(SETTINGS, bench, {"planning": ("policy",)}) as apart:
        apart.loop.reset(0)
        start = bench.joint_position()
        apart.run_until(0.6)
        assert np.abs(bench.joint_position() - start).max() > 0.01, "the policy must drive the arms"
        killed = apart._computers["planning"].process.pid
        os.kill(killed, signal.SIGKILL)
        apart.run_until(1.0)
        held = bench.joint_position()
        apart.run_until(1.4)
        np.testing.assert_allclose(bench.joint_position(), held, atol=1e-3)
        log = apart.loop.health.log
        # A busy machine may have kept a process waiting before.
        told = [event for event in log if event.kind == "crashed"]
        assert [event.stage for event in told] == ["planning"]
        assert f"process {killed} ended by signal 9" in told[0].reason
        cause = apart.loop.health.cause(1.4)
        assert cause is not None
        assert (cause.stage, cause.reason) == ("policy", told[0].reason)
        end = 1.4
        while log[-1].kind != "resumed" and end < PATIENCE:
            end += 0.2
            apart.run_until(end)
        assert log[-1].kind == "resumed"
        assert ("restarted", "planning") in [(event.kind, event.stage) for event in log]
        assert apart._computers["planning"].process.pid != killed
        apart.run_until(end + 0.3)
        assert np.abs(bench.joint_position() - held).max() > 0.005
        assert not apart.hub.refused


@pytest.mark.parametrize(
    ("computers", "words"),
    [
        ({"one": ("camera",)}, "stage 'camera' cannot be elsewhere"),
        ({"one": ("policy",), "two": ("policy",)}, "stage 'policy' is in two places"),
    ],
)
def test_places_that_cannot_be_are_refused(
    computers: dict[str, tuple[str, ...]], words: str
) -> None:
    bench = EpisodesBench(make_episodes("DualMicoPush-v0"))
    with pytest.raises(ValueError, match=words):
        ProcessLoop(SETTINGS, bench, computers)


def test_settings_and_geometry_survive_the_way_to_another_process() -> None:
    assert LoopSettings.from_mapping(SETTINGS.to_mapping()) == SETTINGS
    measured = replace(SETTINGS, seeing=True).measured()
    assert LoopSettings.from_mapping(measured.to_mapping()) == measured
    geometry = EpisodesBench(make_episodes("DualMicoPush-v0")).geometry
    again = BenchGeometry.from_mapping(geometry.to_mapping())
    assert (again.robot, again.held_height) == (geometry.robot, geometry.held_height)
    np.testing.assert_array_equal(again.base_position, geometry.base_position)
    assert again.camera == geometry.camera
    points = np.array([[0.9, -0.3, 0.1], [0.1, 0.9, 0.9]])
    np.testing.assert_array_equal(again.workspace.clip(points), geometry.workspace.clip(points))


def test_a_bench_can_have_another_camera() -> None:
    geometry = replace(
        EpisodesBench(make_episodes("DualMicoPush-v0")).geometry,
        camera=replace(KINECT_V2.scaled(0.5), rate=15.0),
        camera_pose=CameraPose(np.array([0.5, 0.0, 1.0]), np.diag([1.0, -1.0, -1.0])),
    )
    geometry = BenchGeometry.from_mapping(json.loads(json.dumps(geometry.to_mapping())))
    assert geometry.camera == replace(KINECT_V2.scaled(0.5), rate=15.0)
    health = Health((), {})
    lift = build_stage("lift", LoopSettings(), geometry, health)
    frame = build_stage("bench frame", LoopSettings(), geometry, health)
    depth = np.full((212, 256), 0.9, np.float32)
    middle = np.tile(np.asarray(geometry.camera.centre), (14, 1))
    boxes = {name: Mailbox() for name in ("pixel_pose", "picture", "camera_pose")}
    boxes["picture"].put(Picture(UNSTAMPED, np.zeros((212, 256, 3), np.uint8), depth))
    boxes["pixel_pose"].put(PixelPose(UNSTAMPED, middle, np.ones(14)))
    boxes["camera_pose"].put(lift.process(Inputs(boxes), 0.0))
    seen = frame.process(Inputs(boxes), 0.0)
    # Joints lie 0 to 0.1 m behind the surface that the camera, 1 m above the bench, measures.
    np.testing.assert_allclose(seen.positions[:, :2], [[0.5, 0.0]] * 14, atol=5e-3)
    assert ((seen.positions[:, 2] > -0.02) & (seen.positions[:, 2] < 0.11)).all()
    assert 212 * 256 * 7 < Wire(geometry).longest(["picture"]) < 212 * 256 * 7 + 2**18


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"latencies": {"brain": 0.1}}, "latencies: 'brain' is no stage; there are camera"),
        ({"trained_on": "puma"}, "trained_on='puma': must be one of"),
        ({"silent_periods": 0.5}, "silent_periods=0.5"),
    ],
)
def test_settings_that_cannot_be_are_refused(changes: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        LoopSettings(**changes)  # type: ignore[arg-type]


def test_a_stage_can_be_replaced() -> None:
    bench = EpisodesBench(make_episodes("DualMicoPush-v0"))
    names: list[str] = []

    def change(stages):
        names.extend(stage.name for stage in stages)
        return stages

    build_loop(SETTINGS, bench, change)
    assert tuple(names) == SETTINGS.order
