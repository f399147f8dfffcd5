"""A grid and a search on a Ray cluster of two nodes, started here."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from tiny_grids import TINY_RUN, GridFile, tiny_grid

from saver_advisors.cli import main
from saver_advisors.experiments.cluster import RayCluster, local_cluster
from saver_advisors.experiments.grid import read_grid
from saver_advisors.experiments.results import read_result
from saver_advisors.experiments.scheduler import LocalProcesses, Places, work_off
from saver_advisors.experiments.study import open_study
from saver_advisors.training.stopping import Stop
from saver_envs.files import read_json


@pytest.fixture
def nodes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the processes of nodes find the package where this one does."""
    pytest.importorskip("ray")
    root = str(Path(__file__).resolve().parents[2])
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([root, os.environ.get("PYTHONPATH", "")]))


@pytest.fixture
def address(nodes: None) -> Iterator[str]:
    """The address of a cluster of two nodes."""
    with local_cluster(2) as found:
        yield found


@pytest.mark.long
def test_two_nodes_do_what_one_machine_does(
    grid_file: GridFile, tmp_path: Path, address: str
) -> None:
    grid = read_grid(grid_file(tiny_grid()))
    here = Places(tmp_path / "here", tmp_path / "here-results")
    work_off(grid, here, LocalProcesses(here, 2), Stop(), lambda _: None)

    there = Places(tmp_path / "there", tmp_path / "there-results")
    backend = RayCluster(there, address)
    assert backend.at_once == 2
    progress = work_off(grid, there, backend, Stop(), lambda _: None)
    assert not progress.failed, progress.failed
    assert progress.words == {run.name: "done" for run in grid.runs}
    for run in grid.runs:
        ours, theirs = read_result(here.result(run)), read_result(there.result(run))
        assert theirs["final"] == ours["final"]
        assert [p["success_rate"] for p in theirs["curve"]] == [
            p["success_rate"] for p in ours["curve"]
        ]


@pytest.mark.long
def test_a_search_on_two_nodes(
    tmp_path: Path, address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    content = {
        "env_id": "JacoPush-v0",
        "settings": TINY_RUN,
        "space": {"learning_rate": {"log_uniform": [1e-4, 1e-2]}},
        "trials": 3,
        "final_episodes": 2,
    }
    path, output = tmp_path / "search.yml", tmp_path / "search"
    path.write_text(yaml.safe_dump(content))
    words = ["experiments", "search", str(path), "--output", str(output), "--ray", address]
    monkeypatch.setattr(sys, "argv", ["/usr/bin/saver", *words])
    assert main(words) == 0
    study = open_study(output)
    assert [study.state_of(trial) for trial in study.trials] == ["done"] * 3
    for trial in study.trials:
        result = read_result(output / "results" / f"trial-{trial.number:04d}-seed0.json")
        assert result["config"]["learning_rate"] == trial.params["learning_rate"]
        assert result["provenance"]["command"].startswith("saver experiments search")


@pytest.mark.long
def test_scaling_is_measured(nodes: None, tmp_path: Path) -> None:
    path = tmp_path / "scaling.json"
    words = ["--nodes", "1", "2", "--runs", "1", "--steps", "800", "--rounds", "1"]
    assert main(["benchmark", "scaling", *words, "--json", str(path)]) == 0
    found = read_json(path)
    assert [(row["backend"], row["workers"], row["runs"]) for row in found["rows"]] == [
        ("processes", 1, 1),
        ("processes", 2, 2),
        ("ray", 1, 1),
        ("ray", 2, 2),
    ]
    for row in found["rows"]:
        assert row["efficiency"] == 1.0 or row["workers"] == 2
        assert 0 < row["starting_s"] <= row["placing_s"] < row["seconds"]
        assert 0 < row["training_s"] < row["process_s"] <= row["seconds"]
        assert row["idle_s"] >= 0
    assert found["resuming_s"] > 0
    assert found["checkpoint"]["megabytes"] > 1


def test_no_ray_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ImportError, match=r"saver-envs\[cluster\]"):
        RayCluster(Places(tmp_path, tmp_path), "auto")
