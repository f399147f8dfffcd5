"""Curves in TensorBoard and in Weights & Biases: every point once, also of a resumed run."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from commands import Saver, read_json, tiny_train

from saver_advisors.reporting.curve_logging import curve_logs
from saver_advisors.training.curve_file import read_curve


def test_tensorboard_shows_the_whole_curve_of_a_resumed_run(saver: Saver, tmp_path: Path) -> None:
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    folder = tmp_path / "run"
    assert saver(*tiny_train(folder), "--tensorboard").status == 0
    again = ("train", "--output", folder, "--resume", "--no-progress", "--tensorboard")
    assert saver(*again, "--steps", 80).status == 0
    events = accumulator.EventAccumulator(str(folder / "tensorboard"))
    events.Reload()
    shown = [(one.step, one.value) for one in events.Scalars("evaluation/success_rate")]
    assert shown == [(one["steps"], one["success_rate"]) for one in read_curve(folder)]
    assert [steps for steps, _ in shown] == [20, 40, 60, 80]


class FakeRun:
    """A run of Weights & Biases that keeps its points between sessions, as the server does."""

    points: dict[int, dict[str, float]] = {}  # noqa: RUF012  (of the server)

    def __init__(self, **settings: Any) -> None:
        self.settings = settings
        self.starting_step = max(self.points, default=-1) + 1

    def log(self, figures: dict[str, float], step: int) -> None:
        assert step not in self.points, "a point is sent once"
        self.points[step] = figures

    def finish(self) -> None:
        self.finished = True


def test_a_resumed_run_continues_in_wandb(
    saver: Saver, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import sys

    sessions: list[FakeRun] = []

    def init(**settings: Any) -> FakeRun:
        sessions.append(FakeRun(**settings))
        return sessions[-1]

    fake = SimpleNamespace(init=init, Error=RuntimeError)
    monkeypatch.setitem(sys.modules, "wandb", fake)
    monkeypatch.setattr(FakeRun, "points", {})
    folder = tmp_path / "run"
    assert saver(*tiny_train(folder), "--wandb", "mine").status == 0
    again = ("train", "--output", folder, "--resume", "--no-progress", "--wandb", "mine")
    assert saver(*again, "--steps", 80).status == 0
    first, second = (one.settings for one in sessions)
    assert first["id"] == second["id"]
    assert (first["project"], first["resume"], first["name"]) == ("mine", "allow", "run")
    assert first["config"] == {**read_json(folder / "run.json")["config"], "total_steps": 40}
    assert sorted(FakeRun.points) == [20, 40, 60, 80]
    assert all(one.finished for one in sessions)


def test_nobody_is_logged_in(saver: Saver, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    def init(**settings: Any) -> None:
        raise RuntimeError("No API key configured.")

    fake = SimpleNamespace(init=init, Error=RuntimeError)
    monkeypatch.setitem(sys.modules, "wandb", fake)
    result = saver(*tiny_train(tmp_path / "run"), "--wandb")
    assert result.status == 2
    assert "argument --wandb: No API key configured.; or set WANDB_MODE=offline" in result.err


def test_points_are_sent_once_and_contexts_closed() -> None:
    sent: list[int] = []
    closed: list[bool] = []

    @contextmanager
    def destination() -> Any:
        yield lambda point: sent.append(point["steps"])
        closed.append(True)

    curve: list[dict[str, Any]] = []
    with curve_logs([destination()]) as log:
        for steps in (1, 2):
            curve.append({"steps": steps})
            log(curve)
            log(curve)
    assert (sent, closed) == ([1, 2], [True])
