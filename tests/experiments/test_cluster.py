"""A grid on a Ray cluster of two nodes, started here."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from tiny_grids import GridFile, tiny_grid

from saver_advisors.experiments.grid import read_grid
from saver_advisors.experiments.results import read_result
from saver_advisors.experiments.scheduler import LocalProcesses, Places, work_off
from saver_advisors.training.stopping import Stop


@pytest.mark.long
def test_two_nodes_do_what_one_machine_does(
    grid_file: GridFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ray = pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    from saver_advisors.experiments.cluster import RayCluster

    # The nodes' processes find the package where this one does.
    root = str(Path(__file__).resolve().parents[2])
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([root, os.environ.get("PYTHONPATH", "")]))
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    grid = read_grid(grid_file(tiny_grid()))
    here = Places(tmp_path / "here", tmp_path / "here-results")
    work_off(grid, here, LocalProcesses(here, 2), Stop(), lambda _: None)

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    try:
        cluster.add_node(num_cpus=1)
        there = Places(tmp_path / "there", tmp_path / "there-results")
        backend = RayCluster(there, cluster.address)
        try:
            progress = work_off(grid, there, backend, Stop(), lambda _: None)
        finally:
            ray.shutdown()
    finally:
        cluster.shutdown()
    assert not progress.failed, progress.failed
    assert progress.words == {run.name: "done" for run in grid.runs}
    for run in grid.runs:
        ours, theirs = read_result(here.result(run)), read_result(there.result(run))
        assert theirs["final"] == ours["final"]
        assert [p["success_rate"] for p in theirs["curve"]] == [
            p["success_rate"] for p in ours["curve"]
        ]


def test_no_ray_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    from saver_advisors.experiments.cluster import RayCluster

    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ImportError, match=r"saver-envs\[cluster\]"):
        RayCluster(Places(tmp_path, tmp_path), "auto")
