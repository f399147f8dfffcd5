"""Searches: what a file turns into, trials worked off, shared, interrupted and continued."""

from __future__ import annotations

import json
import multiprocessing
import os
import re
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from threading import Thread
from typing import Any

import pytest
import yaml
from optuna.trial import TrialState
from processes import saver, wait_until, workers_of
from tiny_grids import TINY_RUN

from saver_advisors.cli import main
from saver_advisors.experiments import worker
from saver_advisors.experiments.grid import ExperimentRun
from saver_advisors.experiments.recorder import BenchmarkPlan
from saver_advisors.experiments.results import read_result
from saver_advisors.experiments.scheduler import Look, Places, Progress
from saver_advisors.experiments.search import (
    JOURNAL_FILE,
    Objective,
    Search,
    check_search,
    read_search,
)
from saver_advisors.experiments.study import SharedStudy, open_study
from saver_advisors.experiments.trials import TrialWorker, trial_rows
from saver_advisors.training.curve_file import read_curve, write_curve
from saver_advisors.training.settings import RunConfig
from saver_advisors.training.stopping import Stop

ALGORITHMS = Path(__file__).resolve().parents[1] / "benchmarks" / "algorithms.py"
FOREIGN = {"algorithm": f"{ALGORITHMS}:Drifter", "algo_kwargs": {"speed": 0.25}}


def tiny_search(**entries: Any) -> dict[str, Any]:
    """The content of a search's file, with other or further entries."""
    space = {"learning_rate": {"log_uniform": [1e-4, 1e-2]}, "net_arch": {"choice": [[8], [4, 4]]}}
    return {
        "env_id": "JacoPush-v0",
        "settings": TINY_RUN,
        "space": space,
        "objective": {"mean_success": 2},
        "trials": 4,
        "final_episodes": 2,
        **entries,
    }


def curve_of(rates: Sequence[float]) -> list[dict[str, Any]]:
    return [
        {"steps": 40 * index, "success_rate": rate, "wall_clock_s": float(index)}
        for index, rate in enumerate(rates, 1)
    ]


class PretendedRuns:
    """Write the files of runs with known curves, without training.

    :param places: of the files
    :param rates: run -> success rates of its four evaluations
    """

    def __init__(self, places: Places, rates: Callable[[ExperimentRun], Sequence[float]]) -> None:
        self.places = places
        self.at_once = 1
        self.begun: list[str] = []
        self._rates = rates

    def work(self, runs: list[ExperimentRun], progress: Progress, stop: Stop, look: Look) -> None:
        for run in runs:
            self.begun.append(run.name)
            folder, curve = self.places.folder(run), curve_of(self._rates(run))
            folder.mkdir(exist_ok=True)
            for count in range(1, len(curve) + 1):
                if stop:
                    progress.end(run.name, worker.STOPPED, "")
                    return
                write_curve(folder, curve[:count])
                look(progress)
            values = {"kind": "training-run", "task": "JacoPush-v0", "row": run.row, "seed": 0}
            values |= {"name": run.name, "config": run.config.to_mapping(), "curve": curve}
            self.places.result(run).write_text(json.dumps({**values, "finished": True}))
            progress.end(run.name, worker.DONE, "")


@pytest.fixture
def places(tmp_path: Path) -> Places:
    return Places(tmp_path / "search", tmp_path / "search" / "results")


def silent(name: str, words: str) -> None:
    pass


def works(places: Places, content: dict[str, Any], backend: Any, stop: Stop | None = None) -> Any:
    """Work off a search, and return its worker."""
    study = SharedStudy(places.output, Search(content))
    found = TrialWorker(study, places, backend, Stop() if stop is None else stop, silent)
    found.work_off()
    return found


def always(run: ExperimentRun) -> list[float]:
    return [0.0, 0.2, 0.4, 0.6]


# --- the file -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"surplus": 1}, "unknown ['surplus']"),
        ({"env_id": "Push-v9"}, "env_id='Push-v9'"),
        ({"settings": {"speed": 1}}, "unknown speed"),
        ({"space": {}}, "space={} must be names of settings"),
        ({"space": {"speed": {"uniform": [0, 1]}}}, "unknown speed"),
        ({"space": {"gamma": 0.9}}, "space.gamma=0.9 must be {uniform: [low, high]}"),
        ({"space": {"gamma": {"normal": [0, 1]}}}, "space.gamma={'normal': [0, 1]} must be"),
        ({"space": {"gamma": {"uniform": [0.9, 0.8]}}}, "space.gamma: uniform=[0.9, 0.8] must"),
        ({"space": {"gamma": {"uniform": [0.9]}}}, "space.gamma: uniform=[0.9] must be two"),
        ({"space": {"gamma": {"uniform": [0.5, 2.0]}}}, "space.gamma=2.0: gamma=2.0 must be"),
        ({"space": {"tau": {"log_uniform": [0.0, 1.0]}}}, "space.tau: log_uniform=[0.0, 1.0]"),
        ({"space": {"tau": {"uniform": ["1e-4", 1]}}}, "'1e-4' is text in YAML"),
        ({"space": {"n_envs": {"int": [1, 2.5]}}}, "space.n_envs: int=[1, 2.5] must be two int"),
        ({"space": {"net_arch": {"choice": []}}}, "space.net_arch: choice=[] must be"),
        ({"space": {"net_arch": {"choice": [[8], [8]]}}}, "must be one or more distinct values"),
        ({"space": {"net_arch": {"choice": [[8], 9]}}}, "space.net_arch=9"),
        ({"space": {"total_steps": {"int": [1, 9]}}}, "space.total_steps: must be the same in"),
        ({"space": {"env_kwargs.n_arms": {"int": [1, 2]}}}, "space.env_kwargs.n_arms: must be the"),
        ({"space": {"gamma.x": {"choice": [1]}, "gamma": {"choice": [0.9]}}}, "space.gamma"),
        ({"seeds": [-1]}, "seeds=[-1]"),
        ({"trials": 0}, "trials=0"),
        ({"objective": "steps"}, "objective='steps' must be steps_to_0.9, or {mean_success: N}"),
        ({"objective": {"mean_success": 0}}, "objective={'mean_success': 0}"),
        ({"pruner": "median"}, "pruner: the entry must be a mapping"),
        ({"pruner": {"patience": 1}}, "pruner: the entry: unknown ['patience']"),
        ({"pruner": {"warmup_steps": -1}}, "pruner: warmup_steps=-1"),
        ({"final_episodes": 0}, "final_episodes=0"),
        ({"algorithm": "td3"}, "algorithm='td3' must be MODULE:CLASS"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, entries: dict[str, Any], message: str) -> None:
    path = tmp_path / "search.yml"
    path.write_text(yaml.safe_dump(tiny_search(**entries)))
    with pytest.raises(ValueError) as caught:
        read_search(path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_wrong_file_begins_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, output = tmp_path / "search.yml", tmp_path / "runs"
    space = {"train_env_kwargs.n_arms": {"choice": [1, 9]}}
    path.write_text(yaml.safe_dump(tiny_search(space=space)))
    assert main(["experiments", "search", str(path), "--output", str(output)]) == 2
    said = capsys.readouterr().err
    assert "argument SEARCH.yml: space.train_env_kwargs.n_arms=9: " in said
    assert said.count("\n") == 1
    assert not output.exists()


def test_values_are_put_where_the_settings_are() -> None:
    space = {
        "learning_rate": {"log_uniform": [1e-4, 1e-2]},
        "train_env_kwargs.rated": {"choice": [True, False]},
        "advice.budget": {"int": [1, 9]},
    }
    advice = {"teacher": "jaco-push", "strategy": "early"}
    search = Search(tiny_search(space=space, advice=advice, budget_fraction=0.5, seeds=[3, 5]))
    values = {"learning_rate": 0.002, "train_env_kwargs.rated": False, "advice.budget": 7}
    first, second = search.runs("trial-0009", values)
    assert (first.name, second.name) == ("trial-0009-seed3", "trial-0009-seed5")
    config = first.config
    assert isinstance(config, RunConfig)
    assert (config.learning_rate, config.train_env_kwargs) == (0.002, {"rated": False})
    assert config.advice is not None
    assert (config.advice.budget, config.advice.strategy) == (7, "early")
    assert config.env_kwargs == TINY_RUN["env_kwargs"], "the other settings stay"
    assert second.config == config.from_mapping({**config.to_mapping(), "seed": 5})


def test_the_space_of_a_third_party_algorithm() -> None:
    shared = {"total_steps": 160, "eval_every": 40, "eval_episodes": 2}
    space = {"n_envs": {"int": [1, 4]}, "speed": {"uniform": [0.0, 1.0]}}
    search = Search(tiny_search(settings=shared, space=space, **FOREIGN))
    [run] = search.runs("trial-0000", {"n_envs": 3, "speed": 0.75})
    assert isinstance(run.config, BenchmarkPlan)
    assert (run.config.n_envs, run.config.algo_kwargs) == (3, {"speed": 0.75})
    check_search(search)


def test_objectives() -> None:
    mean, steps = Objective(2), Objective(None)
    assert mean.of_run(curve_of([0.0, 1.0, 0.5, 0.7])) == pytest.approx(0.6)
    assert mean.of_run(curve_of([0.3])) == pytest.approx(0.3)
    assert steps.of_run(curve_of([0.5, 0.9, 0.9, 1.0])) == 80
    never = [steps.of_run(curve_of([0.1, 0.2, rate, 0.1])) for rate in (0.2, 0.6, 0.95)]
    assert never[0] > never[1] > never[2] == 160, "runs that never get there are told apart"
    assert steps.midway({"success_rate": 0.75}) == 0.25, "less is better, as of the steps"


# --- trials -------------------------------------------------------------------------------------


def test_trials_have_values_of_the_space_and_the_mean_over_seeds(places: Places) -> None:
    rates = {0: [0.0, 0.0, 0.2, 0.4], 1: [0.0, 0.0, 0.4, 0.8]}
    backend = PretendedRuns(places, lambda run: rates[run.config.seed])
    found = works(places, tiny_search(seeds=[0, 1]), backend)
    assert not found.failed
    trials = found.study.trials
    assert [trial.state for trial in trials] == [TrialState.COMPLETE] * 4
    assert [trial.value for trial in trials] == pytest.approx([0.45] * 4)
    assert [trial.intermediate_values for trial in trials] == [
        {40: 0.0, 80: 0.0, 120: 0.2, 160: 0.4}
    ] * 4, "of the first seed"
    for trial in trials:
        values = found.study.values_of(trial)
        assert 1e-4 <= values["learning_rate"] <= 1e-2
        assert values["net_arch"] in ([8], [4, 4])
        config = read_result(places.results / f"trial-{trial.number:04d}-seed1.json")["config"]
        assert config["learning_rate"] == values["learning_rate"]
        assert config["net_arch"] == values["net_arch"]
    assert len({trial.params["learning_rate"] for trial in trials}) == 4
    assert len(backend.begun) == 8


def test_the_same_file_draws_the_same_trials(places: Places, tmp_path: Path) -> None:
    other = Places(tmp_path / "other", tmp_path / "other" / "results")
    drawn = []
    for one in (places, other):
        found = works(one, tiny_search(), PretendedRuns(one, always))
        drawn.append([trial.params for trial in found.study.trials])
    assert drawn[0] == drawn[1]


def test_a_trial_below_the_median_ends_early(places: Places) -> None:
    def rates(run: ExperimentRun) -> list[float]:
        return [0.0, 0.1, 0.1, 0.9] if run.row == "trial-0003" else [0.5, 0.6, 0.7, 0.8]

    content = tiny_search(pruner={"startup_trials": 2, "warmup_steps": 80}, seeds=[0, 1])
    backend = PretendedRuns(places, rates)
    found = works(places, content, backend)
    assert not found.failed
    last = found.study.trials[3]
    assert last.state is TrialState.PRUNED
    assert list(last.intermediate_values) == [40, 80], "not during the warm-up"
    assert "trial-0003-seed1" not in backend.begun, "its other seeds are not run"
    row = trial_rows(found.study, places)[3]
    assert row[:4] == ["trial-0003", "pruned", "-", "80"]

    never = Places(places.output / "never", places.output / "never" / "results")
    found = works(never, {**content, "pruner": None}, PretendedRuns(never, rates))
    assert found.study.trials[3].state is TrialState.COMPLETE


def test_the_fewest_steps_are_best_and_the_slowest_ends_early(places: Places) -> None:
    curves = [[0.9] * 4, [0.5, 0.9, 0.9, 0.9], [0.8, 0.9, 0.9, 0.9], [0.1] * 4]
    backend = PretendedRuns(places, lambda run: curves[int(run.row[-1])])
    content = tiny_search(objective="steps_to_0.9", pruner={"startup_trials": 3})
    study = works(places, content, backend).study
    assert [trial.value for trial in study.trials[:3]] == [40, 80, 80]
    assert study.best is not None
    assert study.best.number == 0
    assert study.trials[3].state is TrialState.PRUNED
    assert list(study.trials[3].intermediate_values) == [40]


def test_several_processes_share_the_trials(places: Places) -> None:
    content = tiny_search(trials=9, pruner=None)
    workers, threads = [], []
    for _ in range(3):
        study = SharedStudy(places.output, Search(content))
        backend = PretendedRuns(places, always)
        workers.append(TrialWorker(study, places, backend, Stop(), silent))
        threads.append(Thread(target=workers[-1].work_off))
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    trials = open_study(places.output).trials
    assert [trial.state for trial in trials] == [TrialState.COMPLETE] * 9
    begun = [name for one in workers for name in one.backend.begun]
    assert sorted(begun) == [f"trial-{number:04d}-seed0" for number in range(9)], "each once"


def test_more_trials_go_on_and_another_search_is_refused(places: Places) -> None:
    works(places, tiny_search(trials=2), PretendedRuns(places, always))
    backend = PretendedRuns(places, always)
    found = works(places, tiny_search(trials=3, title="More", pruner=None), backend)
    assert backend.begun == ["trial-0002-seed0"]
    assert (found.study.search.title, len(found.study.trials)) == ("More", 3)
    other = tiny_search(objective="steps_to_0.9", seeds=[1])
    with pytest.raises(ValueError, match="objective, seeds: differs from the search in the folder"):
        SharedStudy(places.output, Search(other))


def test_a_stopped_trial_goes_on_where_it_was(places: Places) -> None:
    class StopAfter(Stop):
        def __bool__(self) -> bool:
            return (places.output / "trial-0001-seed0").exists()

    backend = PretendedRuns(places, always)
    found = works(places, tiny_search(), backend, StopAfter())
    assert not found.failed
    states = [found.study.state_of(trial) for trial in found.study.trials]
    assert states == ["done", "interrupted"]
    params = found.study.trials[1].params
    backend = PretendedRuns(places, always)
    study = works(places, tiny_search(), backend).study
    assert backend.begun[0] == "trial-0001-seed0"
    assert study.trials[1].params == params
    assert [study.state_of(trial) for trial in study.trials] == ["done"] * 4


def test_a_failed_trial_is_told_and_tried_again_by_the_next_session(places: Places) -> None:
    class FailingOnce(PretendedRuns):
        def work(self, runs: Any, progress: Progress, stop: Stop, look: Look) -> None:
            if runs[0].row == "trial-0001":
                self.begun.append(runs[0].name)
                progress.end(runs[0].name, worker.FAILED, "MemoryError")
            else:
                super().work(runs, progress, stop, look)

    backend = FailingOnce(places, always)
    found = works(places, tiny_search(), backend)
    assert found.failed == {"trial-0001": "MemoryError"}
    assert backend.begun.count("trial-0001-seed0") == 1
    assert len(found.study.trials) == 4, "the others go on"
    backend = PretendedRuns(places, always)
    assert not works(places, tiny_search(), backend).failed
    assert backend.begun == ["trial-0001-seed0"]


def test_values_that_do_not_fit_together_fail_one_trial(places: Places) -> None:
    # Each value fits the first one of the other setting.
    space = {
        "learning_rate": {"choice": [1e-3, 1e-4]},
        "final_learning_rate": {"choice": [1e-5, 5e-4]},
    }
    found = works(places, tiny_search(space=space, trials=12), PretendedRuns(places, always))
    wrong = [
        trial
        for trial in found.study.trials
        if json.loads(trial.params["final_learning_rate"])
        > json.loads(trial.params["learning_rate"])
    ]
    assert wrong, "a draw that does not fit"
    assert {f"trial-{trial.number:04d}" for trial in wrong} == set(found.failed)
    assert all(trial.state is TrialState.FAIL for trial in wrong)
    assert all("final_learning_rate=0.0005" in words for words in found.failed.values())
    assert len(found.study.trials) == 12


# --- kill -9 ------------------------------------------------------------------------------------


def _killed_within_a_trial(folder: Path, content: dict[str, Any]) -> None:
    with SharedStudy(folder, Search(content)).claimed(()):
        os.kill(os.getpid(), signal.SIGKILL)


def test_kill_9_loses_at_most_the_trial(places: Places) -> None:
    content = tiny_search(trials=3)
    works(places, {**content, "trials": 1}, PretendedRuns(places, always))
    process = multiprocessing.get_context("fork").Process(
        target=_killed_within_a_trial, args=(places.output, content)
    )
    process.start()
    process.join(60)
    assert process.exitcode == -signal.SIGKILL
    study = open_study(places.output)
    assert [study.state_of(trial) for trial in study.trials] == ["done", "interrupted"]
    drawn = study.trials[1].params
    backend = PretendedRuns(places, always)
    study = works(places, content, backend).study
    assert backend.begun == ["trial-0001-seed0", "trial-0002-seed0"]
    assert study.trials[1].params == drawn
    assert [trial.value for trial in study.trials] == pytest.approx([0.5] * 3)


@pytest.mark.long
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks into /proc")
def test_kill_9_of_a_worker_and_of_a_search(tmp_path: Path, places: Places) -> None:
    settings = {**TINY_RUN, "total_steps": 2000, "eval_every": 200, "checkpoint_every": 200}
    path = tmp_path / "search.yml"
    path.write_text(yaml.safe_dump(tiny_search(settings=settings, trials=2)))
    command = ("experiments", "search", path, "--output", places.output)
    first, second = (places.output / f"trial-000{number}-seed0" for number in range(2))
    search = saver(*command)
    try:
        wait_until(lambda: len(read_curve(first)) > 1, 600, "a checkpoint of the first trial")
        for number in workers_of(first):
            os.kill(number, signal.SIGKILL)
        wait_until(lambda: len(read_curve(second)) > 1, 600, "a checkpoint of the second trial")
    finally:
        search.kill()
        search.communicate()
    # The worker of the second trial still writes its checkpoint: it is waited for.
    continued = saver(*command)
    out, _ = continued.communicate(timeout=1200)
    assert continued.returncode == 0, out
    assert out.count("running with") == 2, "no trial but these two"
    for folder in (first, second):
        result = read_result(places.results / f"{folder.name}.json")
        assert [point["steps"] for point in result["curve"]] == list(range(200, 2001, 200))
        assert len(result["sessions"]) == 2
        assert result["sessions"][1]["from_steps"] > 0, "from its checkpoint"


def test_a_line_cut_short_is_mended(places: Places) -> None:
    works(places, tiny_search(trials=2), PretendedRuns(places, always))
    journal = places.output / JOURNAL_FILE
    journal.write_bytes(journal.read_bytes() + b'{"op_code":7,"worker_id":"a4b')
    study = works(places, tiny_search(trials=3), PretendedRuns(places, always)).study
    assert len(study.trials) == 3
    assert len(open_study(places.output).trials) == 3
    assert all(json.loads(line) for line in journal.read_text().splitlines())


# --- the commands -------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_search_on_two_processes_of_this_machine(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "250")
    path, output = tmp_path / "search.yml", tmp_path / "runs"
    path.write_text(yaml.safe_dump(tiny_search(title="Tiny", trials=3)))
    words = ["experiments", "search", str(path), "--output", str(output)]
    assert main([*words, "--trials", "1"]) == 0
    assert main([*words, "--processes", "2"]) == 0
    said = capsys.readouterr().out
    assert re.search(r"trial-0002  done: \d\.\d{3}$", said, re.MULTILINE)
    results = sorted((output / "results").glob("*.json"))
    assert [file.stem for file in results] == [f"trial-000{number}-seed0" for number in range(3)]
    for file in results:
        result = read_result(file)
        assert result["finished"]
        assert result["final"]["episodes"] == 2
    before = {file: file.stat().st_mtime_ns for file in results}
    assert main(words) == 0, "there is nothing left to do"
    assert {file: file.stat().st_mtime_ns for file in results} == before

    capsys.readouterr()
    assert main(["experiments", "status", str(output)]) == 0
    said = capsys.readouterr().out
    assert "Tiny: 3 of 3 trials" in said
    for trial in open_study(output).trials:
        assert f"{trial.params['learning_rate']:.4g}" in said
    assert said.splitlines()[-1].startswith("best: ")
    assert main(["experiments", "status", str(output), "--only", "0001"]) == 0
    said = capsys.readouterr().out
    assert "trial-0001" in said
    assert "trial-0002" not in said
    assert main(["experiments", "resume", str(output)]) == 2
    assert "holds a search: the command that started it" in capsys.readouterr().err
