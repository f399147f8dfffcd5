"""Stages in processes: one is killed in the midst of a trial, the arms hold, it comes back."""

from __future__ import annotations

import os
import signal
from dataclasses import replace

import numpy as np
import pytest

from saver_advisors.integration.assembly import LoopSettings, build_loop
from saver_advisors.integration.bench import BenchGeometry, EpisodesBench
from saver_advisors.integration.safety import SafetyLimits
from saver_advisors.integration.supervisor import SILENT_PERIODS, ProcessLoop
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
        apart.reset(0)
        start = bench.joint_position()
        apart.run_until(0.6)
        assert np.abs(bench.joint_position() - start).max() > 0.01, "the policy must drive the arms"
        killed = apart.process_of("planning")
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
        assert apart.process_of("planning") != killed
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
    points = np.array([[0.9, -0.3, 0.1], [0.1, 0.9, 0.9]])
    np.testing.assert_array_equal(again.workspace.clip(points), geometry.workspace.clip(points))


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
