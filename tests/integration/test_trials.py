"""How trials are judged, told and shown; the page from a file of figures."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from reproduction.command_parts import shares
from reproduction.program import main as reproduce
from reproduction.wrist_push.loop_trials import fault_row, play_row
from reproduction.wrist_push.wrist_push_command import render
from saver_advisors.cli import main
from saver_advisors.integration.assembly import LoopSettings, settings_for
from saver_advisors.integration.health import Event
from saver_advisors.integration.trial import PUSHING, REACHING, SUCCEEDED, TrialRecord
from saver_envs.tasks.wrist_push import WristPush


def record(
    end: tuple[float, float], force: float = 0.0, displacement: float = 0.0, held: float = 0.0
) -> TrialRecord:
    """A trial in which both wrists begin 20 cm away and come straight to where they end."""
    steps = 11
    distance = np.linspace((0.2, 0.2), end, steps)
    event = Event(0.4, "stopped", "pose", "no person found")
    return TrialRecord(
        seed=3,
        distance=distance,
        torso_force=np.linspace(0, force, steps),
        torso_displacement=np.linspace(0, displacement, steps),
        hand_force=np.zeros((steps, 2)),
        holding=np.arange(steps) < held * steps,
        log=(event,) if held else (),
    )


@pytest.mark.parametrize(
    ("trial", "outcome", "words"),
    [
        (record((0.03, 0.04)), SUCCEEDED, ""),
        (record((0.03, 0.19)), REACHING, "the left wrist ended 19 cm away"),
        (record((0.08, 0.04)), PUSHING, "the right wrist ended 8 cm away"),
        (record((0.03, 0.04), force=51.0), PUSHING, "the trunk was pressed with 51 N"),
        (record((0.03, 0.04), displacement=0.021), PUSHING, "the trunk was moved by 21 mm"),
        (record((0.2, 0.2), held=0.5), REACHING, "held for 55% of the time, at last for pose: no"),
    ],
)
def test_outcomes_and_causes(trial: TrialRecord, outcome: str, words: str) -> None:
    assert trial.outcome == outcome
    assert words in trial.cause
    assert bool(trial.cause) == (outcome != SUCCEEDED)


def test_a_table_counts_every_trial_once() -> None:
    trials = [record((0.03, 0.04)), record((0.03, 0.19)), record((0.03, 0.04), force=60.0)]
    played = {"trials": [one.summary() for one in trials], "wall_s": 1.0, "ages": [0.1]}
    counted = play_row(lambda *_: [{**played, "stages": {}}], LoopSettings(), len(trials), 0)
    assert {key: counted[key] for key in ("trials", "succeeded", "harmed")} == {
        "trials": 3,
        "succeeded": 1,
        "harmed": 1,
    }
    assert (counted["failed_reaching"], counted["failed_pushing"]) == (1, 1)
    low, high = counted["ci95"]
    assert 0 < low < 1 / 3 < high < 1


@pytest.fixture
def short_trials(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten actions are enough to see that something runs."""
    from saver_advisors.integration import trial

    monkeypatch.setattr(trial.run_trial, "__defaults__", (10, None, None))
    assert WristPush.horizon == 250


@pytest.mark.slow
@pytest.mark.usefixtures("short_trials")
def test_figures_become_a_page(tmp_path: Path) -> None:
    from dataclasses import replace

    settings = replace(settings_for("expert"), seeing=False)
    with shares(1) as share:
        row = play_row(share, settings, 2, 0)
        fault = fault_row(share, settings, "not a number", 1, 0)
    figures = {
        "kind": "wrist-push",
        "trials": 2,
        "seed": 0,
        "processes": 1,
        "settings": settings.to_mapping(),
        "rows": [{"row": "true-state-learned", **row}],
        "faults": [fault],
        "provenance": {
            "command": "saver",
            "commit": None,
            "time": "now",
            "machine": {"cpu": "a", "cores": 2},
        },
    }
    assert fault["stopped_in_time"] == fault["named_rightly"] == fault["recovered"] == 1
    page = render(json.loads(json.dumps(figures, allow_nan=False)))
    assert "| paper, on real arms | 20 | 15 | 0.75 | - | 2 | 3 | - |" in page
    assert "| true state, learned kinematics | 2 |" in page
    assert "not a number: the policy asks for NaN | 1 | 1 | 1 |" in page
    assert "| policy | 25.0 |" in page
    path = tmp_path / "figures.json"
    path.write_text(json.dumps(figures), encoding="utf-8")
    table = tmp_path / "page.md"
    assert reproduce(["wrist-push", "--from", str(path), "--table", str(table)]) == 0
    assert table.read_text(encoding="utf-8") == page


@pytest.mark.slow
@pytest.mark.usefixtures("short_trials")
def test_a_report_shows_what_failed(tmp_path: Path) -> None:
    arguments = ["run", "wrist-push", "--policy", "expert", "--true-state", "--exact-ik"]
    assert main([*arguments, "--report", str(tmp_path / "report")]) == 0
    page = (tmp_path / "report" / "index.html").read_text(encoding="utf-8")
    assert "failed in" in page
    assert 'src="trial-0.mp4"' in page
    assert (tmp_path / "report" / "trial-0.mp4").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--policy", "nobody"], "argument --policy"),
        (["--policy", "jaco-push"], "must push with two arms"),
        (["--max-speed", "-1"], "argument --max-speed"),
        (["--apart", "--view"], "argument --apart"),
    ],
)
def test_mistakes_are_told_in_a_line(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", "wrist-push", *arguments]) == 2
    told = capsys.readouterr().err
    assert words in told
    assert len(told.strip().splitlines()) == 1


def test_another_benchmarks_file_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "speed.json"
    path.write_text('{"kind": "speed"}', encoding="utf-8")
    assert reproduce(["wrist-push", "--from", str(path)]) == 2
    assert "does not hold figures of the kind 'wrist-push'" in capsys.readouterr().err


def test_settings_fit_the_policy() -> None:
    assert settings_for("dual-jaco-push") == LoopSettings()
    assert settings_for("expert").wrist_height is None
