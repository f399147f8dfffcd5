"""Grids worked off: results, resuming, failures, two at once, kill -9."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from filelock import FileLock
from processes import saver, wait_until, workers_of
from tiny_grids import GridFile, run_named, tiny_grid

from saver_advisors.experiments import worker
from saver_advisors.experiments.grid import ExperimentRun, Grid, read_grid
from saver_advisors.experiments.progress import rows
from saver_advisors.experiments.results import is_done, read_result, state_of, write_result
from saver_advisors.experiments.scheduler import (
    LocalProcesses,
    Places,
    Progress,
    work_off,
)
from saver_advisors.training.curve_file import OF_THE_MACHINE
from saver_advisors.training.release import evaluate_trained
from saver_advisors.training.stopping import Stop


@pytest.fixture
def run(grid_file: GridFile) -> ExperimentRun:
    """An advised run of a second."""
    return run_named("push-early-seed0", read_grid(grid_file(tiny_grid())))


@pytest.fixture
def places(tmp_path: Path) -> Places:
    return Places(tmp_path / "runs", tmp_path / "results")


def without_clock(curve: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{k: v for k, v in point.items() if k not in OF_THE_MACHINE} for point in curve]


def test_a_run_leaves_a_result(run: ExperimentRun, places: Places) -> None:
    places.results.mkdir()
    assert state_of(run, places.folder(run), places.result(run)).state == "waiting"
    assert worker.execute(run, places.folder(run), places.result(run)) == worker.DONE
    result = read_result(places.result(run))
    assert result["finished"]
    assert result["final"]["episodes"] == 2
    assert result["final"]["seed"] == 0
    assert result["teacher_steps"] > 100_000, "the teacher's own training counts"
    assert result["curve"][-1]["steps"] == 160
    assert 0 < result["curve"][-1]["advice_spent"] <= 40
    assert result["provenance"]["versions"]["mujoco"]
    state = state_of(run, places.folder(run), places.result(run))
    assert (state.state, state.steps) == ("done", 160)
    before = places.result(run).read_bytes()
    assert worker.execute(run, places.folder(run), places.result(run)) == worker.DONE
    assert places.result(run).read_bytes() == before, "what is done is not done again"


def test_a_result_cut_short_is_made_again(run: ExperimentRun, places: Places) -> None:
    places.results.mkdir()
    worker.execute(run, places.folder(run), places.result(run))
    whole = places.result(run).read_text()
    places.result(run).write_text(whole[: len(whole) // 2])
    assert not is_done(places.result(run), run)
    with pytest.raises(ValueError, match=f"{places.result(run).name} is truncated"):
        read_result(places.result(run))
    assert worker.execute(run, places.folder(run), places.result(run)) == worker.DONE
    assert read_result(places.result(run))["curve"] == json.loads(whole)["curve"]


@pytest.mark.parametrize("curve", [None, [], 5, [5], [{}], [{"steps": "many"}]])
def test_a_result_without_a_curve_does_not_count(
    run: ExperimentRun, places: Places, curve: Any
) -> None:
    places.results.mkdir()
    whole = {"kind": "training-run", "task": "DualJacoPush-v0", "row": "early", "seed": 0}
    whole |= {"name": run.name, "config": run.config.to_mapping(), "finished": True}
    point = {"steps": 160, "success_rate": 0.5, "wall_clock_s": 1.0}
    for content, done in (([point], True), (curve, False)):
        places.result(run).write_text(json.dumps({**whole, "curve": content}))
        assert is_done(places.result(run), run) is done
    assert state_of(run, places.folder(run), places.result(run)).state == "waiting"


def test_a_result_of_other_settings_does_not_count(
    grid_file: GridFile, run: ExperimentRun, places: Places
) -> None:
    places.results.mkdir()
    worker.execute(run, places.folder(run), places.result(run))
    longer = run_named(run.name, read_grid(grid_file(tiny_grid(total_steps=240))))
    assert is_done(places.result(run), run)
    assert not is_done(places.result(longer), longer)


def test_a_part_of_a_run_is_no_whole_one(run: ExperimentRun, places: Places) -> None:
    from saver_advisors.training.launch import train

    places.results.mkdir()
    train(run.config, places.folder(run), progress=False, stop_after_steps=80)
    result = write_result(run, places.folder(run), places.result(run))
    assert not result["finished"]
    assert result["final"] is None
    assert not is_done(places.result(run), run)
    assert state_of(run, places.folder(run), places.result(run)).state == "started"


def test_a_run_that_somebody_has_is_left_alone(run: ExperimentRun, places: Places) -> None:
    places.results.mkdir()
    places.folder(run).mkdir(parents=True)
    with FileLock(places.folder(run) / ".lock"):
        assert worker.execute(run, places.folder(run), places.result(run)) == worker.BUSY
    assert not places.result(run).exists()


def test_a_failure_is_told_and_the_others_go_on(
    grid_file: GridFile, places: Places, monkeypatch: pytest.MonkeyPatch
) -> None:
    grid = read_grid(grid_file(tiny_grid()))
    first = grid.runs[0]
    places.folder(first).mkdir(parents=True)
    # A checkpoint that cannot be one.
    (places.folder(first) / "latest").mkdir()
    (places.folder(first) / "latest" / "state.json").write_text("{")

    def pretend(
        run: ExperimentRun, folder: Path, result: Path, threads: int
    ) -> subprocess.Popen[bytes]:
        if run.name == first.name:
            return start(run, folder, result, threads=threads)
        return subprocess.Popen([sys.executable, "-c", "pass"])

    start = worker.start
    monkeypatch.setattr(worker, "start", pretend)
    progress = work_off(grid, places, LocalProcesses(places, 2), Stop(), lambda _: None)
    assert set(progress.failed) == {first.name}
    assert "state.json" in progress.failed[first.name]
    assert {run.name for run in grid.runs if progress.words[run.name] == "done"} == {
        run.name for run in grid.runs[1:]
    }


def test_time_is_over_at_once(grid_file: GridFile, places: Places) -> None:
    grid = read_grid(grid_file(tiny_grid()))
    seen: list[Progress] = []
    progress = work_off(grid, places, LocalProcesses(places, 1), Stop(0.0), seen.append)
    assert not progress.words
    assert seen, "whoever looks is told"


def test_results_name_the_command_that_was_typed(
    run: ExperimentRun, places: Places, monkeypatch: pytest.MonkeyPatch
) -> None:
    places.results.mkdir()
    typed = ["/usr/bin/saver", "experiments", "run", "/home/somebody/grid.yml"]
    monkeypatch.setattr(sys, "argv", typed)
    process = worker.start(run, places.folder(run), places.result(run))
    assert process.wait(timeout=240) == worker.DONE
    result = read_result(places.result(run))
    wanted = "saver experiments run grid.yml"
    assert result["provenance"]["command"] == wanted
    assert [one["command"] for one in result["sessions"]] == [wanted]


@pytest.mark.long
def test_more_threads_simulate_the_same(run: ExperimentRun, places: Places) -> None:
    places.results.mkdir()
    alone, shared = places.output / "alone", places.output / "shared"
    assert worker.execute(run, alone, places.results / "alone.json") == worker.DONE
    process = worker.start(run, shared, places.results / "shared.json", threads=2)
    assert list(process.args)[-2:] == ["--threads", "2"]  # type: ignore[arg-type]
    assert process.wait(timeout=240) == worker.DONE
    first, second = (read_result(places.results / f"{name}.json") for name in ("alone", "shared"))
    # The teachers act in both, and what they see is what the simulation does.
    assert [point["training_cost"] for point in first["curve"]] == [
        point["training_cost"] for point in second["curve"]
    ]


def test_final_episodes_outlive_an_interruption(
    grid_file: GridFile, places: Places, monkeypatch: pytest.MonkeyPatch
) -> None:
    places.results.mkdir()
    run = replace(read_grid(grid_file(tiny_grid())).runs[0], final_episodes=70)
    folder, result = places.folder(run), places.result(run)
    played: list[int] = []

    def evaluate(*arguments: Any, **options: Any) -> Any:
        if len(played) == 2:
            raise KeyboardInterrupt
        played.append(options["seed"])
        return evaluate_trained(*arguments, **options)

    monkeypatch.setattr("saver_advisors.training.release.evaluate_trained", evaluate)
    with pytest.raises(KeyboardInterrupt):
        worker.execute(run, folder, result)
    assert not result.exists()
    state = state_of(run, folder, places.result(run))
    assert (state.state, state.steps) == ("final episodes 64 of 70", 160)
    assert "final episodes 64 of 70" in rows(Grid("", (run,)), places)[0]
    running = rows(Grid("", (run,)), places, Progress({run.name: "running"}))[0]
    assert "running final episodes 64 of 70" in running
    played.clear()
    assert worker.execute(run, folder, result) == worker.DONE
    assert played == [64], "only those that were left"
    whole = evaluate_trained(folder, "latest", episodes=70, seed=0)
    assert read_result(result)["final"] == whole.summary()
    assert state_of(run, folder, places.result(run)).state == "done"


def third_party_grid(steps: int) -> dict[str, Any]:
    content = tiny_grid(total_steps=steps, eval_every=steps // 2)
    algorithm = Path(__file__).resolve().parents[1] / "benchmarks" / "algorithms.py"
    content["groups"]["push"]["rows"] = {"mine": {"algorithm": f"{algorithm}:Drifter"}}
    return content


def test_a_third_party_algorithm_is_run_in_a_grid(grid_file: GridFile, places: Places) -> None:
    grid = read_grid(grid_file(third_party_grid(80)))
    progress = work_off(grid, places, LocalProcesses(places, 1), Stop(), lambda _: None)
    assert progress.words == {"push-mine-seed0": "done"}
    result = read_result(places.result(grid.runs[0]))
    assert (result["row"], result["group"], result["finished"]) == ("mine", "push", True)
    assert [point["steps"] for point in result["curve"]] == [40, 80]
    assert result["final"]["episodes"] == 2
    state = state_of(grid.runs[0], places.folder(grid.runs[0]), places.result(grid.runs[0]))
    assert (state.state, state.steps) == ("done", 80)
    longer = read_grid(grid_file(third_party_grid(160))).runs[0]
    assert not is_done(places.result(longer), longer)


def test_a_stopped_third_party_run_starts_again(grid_file: GridFile, places: Places) -> None:
    places.results.mkdir()
    run = read_grid(grid_file(third_party_grid(10_000_000))).runs[0]
    process = worker.start(run, places.folder(run), places.result(run))
    steps = places.folder(run) / "steps.json"
    wait_until(steps.exists, 120, "the first steps")
    process.terminate()
    assert process.wait(timeout=60) == worker.STOPPED
    assert not is_done(places.result(run), run)
    state = state_of(run, places.folder(run), places.result(run))
    assert state.state == "started"
    assert state.steps > 0
    short = read_grid(grid_file(third_party_grid(80))).runs[0]
    assert worker.execute(short, places.folder(short), places.result(short)) == worker.DONE


def test_workers_import_nothing_from_the_current_folder(
    run: ExperimentRun, places: Places, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    places.results.mkdir()
    (tmp_path / "tqdm.py").write_text("raise SystemExit('imported from the current folder')")
    monkeypatch.chdir(tmp_path)
    process = worker.start(run, places.folder(run), places.result(run))
    assert process.wait(timeout=240) == worker.DONE, worker.last_words(places.folder(run))


# --- kill -9 ------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks into /proc")
def test_kill_9_in_the_midst_of_a_run_and_of_a_grid(
    grid_file: GridFile, tmp_path: Path, places: Places
) -> None:
    path = grid_file(tiny_grid(total_steps=2000, eval_every=200, checkpoint_every=200))
    grid = read_grid(path)
    untouched = Places(tmp_path / "untouched", tmp_path / "untouched" / "results")
    work_off(grid, untouched, LocalProcesses(untouched, 1), Stop(), lambda _: None)

    first, second, _ = grid.runs
    command = ("experiments", "run", path, "--output", places.output, "--results", places.results)
    scheduler = saver(*command)
    try:
        # The worker of the first run, in its midst.
        curve = places.folder(first) / "curve.jsonl"
        wait_until(
            lambda: curve.exists() and curve.stat().st_size, 120, "an evaluation of the first run"
        )
        for number in workers_of(places.folder(first)):
            os.kill(number, signal.SIGKILL)
        # The scheduler, in the midst of the second run.
        curve = places.folder(second) / "curve.jsonl"
        wait_until(
            lambda: curve.exists() and curve.stat().st_size, 120, "an evaluation of the second run"
        )
        orphans = workers_of(places.folder(second))
        scheduler.kill()
        for number in orphans:
            os.kill(number, signal.SIGKILL)
    finally:
        scheduler.kill()
        scheduler.communicate()
    resumed = saver("experiments", "resume", places.output)
    out, _ = resumed.communicate(timeout=240)
    assert resumed.returncode == 0, out
    for run in grid.runs:
        result = read_result(places.result(run))
        wanted = read_result(untouched.result(run))
        assert without_clock(result["curve"]) == without_clock(wanted["curve"]), run.name
        assert result["final"] == wanted["final"]
    assert len(list(places.results.glob("*.json"))) == len(grid.runs)
    assert len(read_result(places.result(first))["sessions"]) == 2


@pytest.mark.long
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks into /proc")
def test_workers_stop_when_their_scheduler_is_gone(grid_file: GridFile, places: Places) -> None:
    path = grid_file(tiny_grid(total_steps=1_000_000, eval_every=200, checkpoint_every=200))
    first = read_grid(path).runs[0]
    scheduler = saver("experiments", "run", path, "--output", places.output)
    try:
        curve = places.folder(first) / "curve.jsonl"
        wait_until(lambda: curve.exists() and curve.stat().st_size, 120, "an evaluation")
    finally:
        scheduler.kill()
        scheduler.communicate()
    wait_until(lambda: not workers_of(places.folder(first)), 60, "the worker's end")
    result = read_result(places.output / "results" / f"{first.name}.json")
    assert not result["finished"]
    assert result["curve"], "what was done is kept"
