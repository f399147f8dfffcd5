"""The grid of chapter 7: the paper's figures, resuming, judging, rendering. Nothing is trained."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from reproduction.modelling import grid, kinematics, tracking, training_time
from reproduction.modelling.grid import (
    GridCell,
    as_known,
    cells_of,
    read_result,
    results_of,
    run_grid,
)
from reproduction.modelling.grid_page import render
from reproduction.modelling.paper_claims import (
    ADVERSARIAL,
    CLAIMS,
    RmseTable,
    claims,
    little_data,
    paper,
    paper_cells,
)
from reproduction.program import main as reproduce
from saver_envs.modelling.accuracy import distances

MODELS = (*ADVERSARIAL, "mlp")


def result(cell: GridCell, test: float = 0.5) -> dict[str, Any]:
    """What a cell's file holds."""
    spread = {"median": 1.0, "p99": 2.0, "mean": 1.1}
    return {
        **asdict(cell),
        "validation_rmse": test / 2,
        "validation_rmse_moving": test / 2,
        "test_rmse": test,
        "test_rmse_moving": test,
        "per_joint": [test] * 4,
        "latency_ms": 0.05,
        "batch_us": 5.0,
        "training_s": {"wall": 2.0, "cpu": 1.0},
        "task_space_mm": {"raw": spread, "refined": spread},
    }


@pytest.fixture
def trained(monkeypatch: pytest.MonkeyPatch) -> list[GridCell]:
    """Cells that were run instead of being trained."""
    done: list[GridCell] = []

    def fake(cell: GridCell) -> dict[str, Any]:
        done.append(cell)
        return result(cell)

    monkeypatch.setattr(grid, "run_cell", fake)
    return done


def test_the_papers_tables_are_whole() -> None:
    for robot in ("mico", "fetch"):
        for task in ("ik", "id"):
            cells = paper()["tables"][robot][task]
            assert len(cells) == 6 * 4 * 4 + 6
            assert len({(c["model"], c["size"], c["sigma"]) for c in cells}) == len(cells)


@pytest.mark.parametrize(
    ("robot", "task", "model", "size", "sigma", "test"),
    [
        ("mico", "ik", "mlp", 1, 0.0, 0.54),
        ("mico", "ik", "cgan", 1, 0.2, 0.395),
        ("mico", "ik", "mlp", 6, 0.0, 0.16),
        ("mico", "id", "cgan", 6, 0.0, 0.22),
        ("mico", "id", "mlp", 6, 0.0, 0.14),
        ("mico", "id", "analytic", 6, 0.0, 0.4082),
        ("fetch", "ik", "mlp", 6, 0.0, 0.90),
        ("fetch", "ik", "dualgan", 6, 0.4, 0.92),
        ("fetch", "id", "cgan", 6, 0.0, 12.87),
        ("fetch", "id", "lsgan", 6, 0.0, 12.70),
        ("fetch", "id", "mlp", 6, 0.0, 13.01),
        ("fetch", "id", "cgan", 5, 0.2, 12.67),
    ],
)
def test_the_papers_anchors(
    robot: str, task: str, model: str, size: int, sigma: float, test: float
) -> None:
    found = [
        cell["test"]
        for cell in paper_cells(robot, task)
        if (cell["model"], cell["size"], cell["sigma"]) == (model, size, sigma)
    ]
    assert found == [test]


def test_the_grid_has_one_cell_of_what_sigma_does_not_change() -> None:
    cells = cells_of("mico", "ik", ["mlp", "cgan", "analytic"], [1, 6], [0.0, 0.2], [0, 1], 100)
    count = {model: sum(c.model == model for c in cells) for model in ("mlp", "cgan", "analytic")}
    assert count == {"mlp": 4, "cgan": 8, "analytic": 2}
    assert len({cell.file_name for cell in cells}) == len(cells)
    weighted = cells_of("mico", "ik", ["mlp", "cgan"], [1], [0.0], [0], 100, 0.5)
    assert [cell.supervised_weight for cell in weighted] == [0.0, 0.5]
    assert "supervised0.5" in weighted[1].file_name


def test_a_killed_grid_goes_on_where_it_was(tmp_path: Path, trained: list[GridCell]) -> None:
    cells = cells_of("mico", "ik", ["mlp", "cgan"], [1, 2], [0.0], [0], 3)
    assert len(list(run_grid(cells[:2], tmp_path, 1))) == 2
    whole = (tmp_path / cells[0].file_name).read_text()
    (tmp_path / cells[0].file_name).write_text(whole[: len(whole) // 2])
    # Of other settings: not an answer to what is asked.
    other = GridCell(**{**asdict(cells[1]), "epochs": 4})
    (tmp_path / cells[1].file_name).write_text(
        json.dumps({**result(other), "provenance": {"commit": None}})
    )
    assert read_result(tmp_path, cells[0]) is None
    assert read_result(tmp_path, cells[1]) is None
    trained.clear()
    list(run_grid(cells, tmp_path, 1))
    assert trained == cells
    trained.clear()
    assert list(run_grid(cells, tmp_path, 1)) == []
    assert trained == []
    assert [one["model"] for one in results_of(cells, tmp_path)] == [c.model for c in cells]
    assert read_result(tmp_path, cells[0])["provenance"]["versions"]  # type: ignore[index]


def everywhere(robot: str, task: str, figure: Any) -> list[dict[str, Any]]:
    """Results of a whole grid, of test errors by (model, size, sigma)."""
    models = [*MODELS, "analytic"]
    cells = cells_of(robot, task, models, range(1, 7), (0.0, 0.2, 0.4, 0.6), [0], 100)  # type: ignore[arg-type]
    return [result(cell, figure(cell.model, cell.size, cell.sigma)) for cell in cells]


def test_the_paper_says_what_it_says_of_its_own_tables() -> None:
    for robot, task in CLAIMS:
        for one in claims(robot, task, []):
            assert one["here"]["holds"] is None
            assert one["paper"]["holds"] is not None
    held = {
        one["claim"]: one["paper"]["holds"]
        for robot, task in CLAIMS
        for one in claims(robot, task, [])
    }
    for claim in (
        "With 10,000 samples the best GAN beats the MLP on the unseen trajectory",
        "With all data the MLP is better than every GAN",
        "DualGAN is the best of the GANs",
        "Most GAN cells beat the MLP on the unseen trajectory",
        "The analytic model is the worst",
    ):
        assert held[claim], claim


def test_claims_follow_the_figures() -> None:
    def of(best: str) -> list[dict[str, Any]]:
        return everywhere("mico", "ik", lambda model, size, _: (1 if model == best else 2) / size)

    by_gan = claims("mico", "ik", of("bigan"))
    by_mlp = claims("mico", "ik", of("mlp"))
    assert by_gan[0]["here"]["holds"] is None, "one seed has no interval"
    seeds = [
        {**one, "seed": seed, "test_rmse_moving": one["test_rmse_moving"] + 0.01 * seed}
        for seed in range(3)
        for one in of("bigan")
    ]
    assert claims("mico", "ik", seeds)[0]["here"]["holds"] is True
    # One seed the other way: better on average, and not beyond chance.
    for one in seeds:
        if one["seed"] == 2 and one["model"] == "bigan":
            one["test_rmse_moving"] = 2.5
    mixed = claims("mico", "ik", seeds)[0]["here"]
    assert mixed["holds"] is None and "no GAN's 95% interval" in mixed["figures"]
    assert by_mlp[0]["here"]["holds"] is False
    assert by_gan[1]["here"]["holds"] is True
    worst = everywhere("fetch", "id", lambda model, *_: 40 if model == "analytic" else 12)
    assert claims("fetch", "id", worst)[3]["here"]["holds"] is True
    best = everywhere("fetch", "id", lambda model, *_: 4 if model == "analytic" else 12)
    assert claims("fetch", "id", best)[3]["here"]["holds"] is False


def test_seeds_are_averaged() -> None:
    cell = {"model": "mlp", "size": 1, "sigma": 0.0}
    table = RmseTable([{**cell, "test": 1.0}, {**cell, "test": 3.0}])
    assert table.best("mlp", 1) == 2.0
    with pytest.raises(KeyError):
        table.best("mlp", 2)


def test_the_command(
    tmp_path: Path,
    trained: list[GridCell],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from reproduction.modelling import grid_command

    monkeypatch.setattr(grid_command, "prepare_data", lambda *_: None)
    figures, page = tmp_path / "ik.json", tmp_path / "ik.md"
    words = "ik --robot mico --models mlp cgan --sizes 1 --sigmas 0 0.2 --seeds 0 1"
    command = [*words.split(), "--epochs", "2", "--results", str(tmp_path / "cells")]
    assert reproduce([*command, "--json", str(figures), "--table", str(page)]) == 0
    assert len(trained) == 6
    content = json.loads(figures.read_text())
    assert len(content["cells"]) == 6
    assert content["provenance"].keys() >= {"command", "commit"}
    text = page.read_text()
    assert "# Inverse kinematics, mico, 10,000 samples\n" in text
    assert "0.25 / 0.5 (0.09 / 0.395)" in text
    assert text == render(content) or render({**content, "provenance": None}) in text
    capsys.readouterr()
    assert reproduce(["ik", "--from", str(figures)]) == 0
    assert "Da1-Dev1" in capsys.readouterr().out
    assert reproduce(["id", "--from", str(figures)]) == 2
    assert "modelling-id" in capsys.readouterr().err
    empty = ["--no-training", "--results", str(tmp_path / "none")]
    assert reproduce(["ik", "--sizes", "2", *empty]) == 2
    assert "has none of the cells" in capsys.readouterr().err


def test_little_data_is_judged_by_pairs_of_seeds() -> None:
    cells = cells_of("mico", "ik", ["mlp", "cgan"], [1, 2], [0.2], [0, 1, 2], 100)
    cells += cells_of("mico", "ik", ["cgan"], [1], [0.2], [0], 100, 1.0)
    figures = {"mlp": (0.5, 0.6, 0.7), "cgan": (0.4, 0.55, 0.6)}
    results = [result(one, figures[one.model][one.seed]) for one in cells]
    plain, supervised = little_data("ik", results)
    assert (plain["seeds"], plain["supervised_weight"]) == (3, 0.0)
    assert plain["difference"] == pytest.approx(-0.25 / 3)
    low, high = plain["interval"]
    # Student's t of (-0.1, -0.05, -0.1): 4.303 x 0.02887 / sqrt(3) either way.
    assert (high - low) / 2 == pytest.approx(4.303 * 0.028868 / 3**0.5, rel=1e-3)
    assert supervised["interval"] is None
    assert little_data("ik", [one for one in results if one["size"] == 2]) == []
    page = render(
        {"title": "T", "robot": "mico", "task": "ik", "epochs": 30, "cells": results}
        | {"claims": [], "little_data": [plain, supervised]}
    )
    assert "| cgan | 0.2 | 0 | 3 | -0.083 | [-0.155, -0.012] |" in page
    assert "30 of the paper's 100 epochs. Size k" in page
    assert "| cgan + 1 MSE | 1 |" in page


def test_epochs_and_precision_have_files_of_their_own() -> None:
    cells = [
        cells_of("mico", "ik", ["mlp"], [1], [0.0], [0], epochs, 0.0, precision)[0]
        for epochs in (30, 100)
        for precision in ("float32", "bfloat16")
    ]
    assert len({cell.file_name for cell in cells}) == 4
    flow = cells_of("mico", "ik", ["flow"], [1], [0.0], [0], 100, 0.0, "bfloat16")
    assert flow[0].precision == "float32"


def test_what_a_gpu_trained_has_a_file_of_its_own(tmp_path: Path, trained: list[GridCell]) -> None:
    models = ["mlp", "flow", "analytic"]
    there = cells_of("mico", "ik", models, [1], [0.0], [0], 100, device="cuda")
    here = cells_of("mico", "ik", models, [1], [0.0], [0], 100)
    assert [cell.device for cell in there] == ["cuda", "cuda", "cpu"]
    assert len({cell.file_name for cell in (*there, *here)}) == 5
    list(run_grid(here[:1], tmp_path, 1))
    assert read_result(tmp_path, there[0]) is None
    # A file from before there was a choice is of the CPU.
    path = tmp_path / here[0].file_name
    content = json.loads(path.read_text())
    del content["device"]
    path.write_text(json.dumps(content))
    assert read_result(tmp_path, here[0]) == content


def test_a_grid_on_a_gpu_is_refused_where_there_is_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if torch.cuda.is_available():
        pytest.skip("there is a GPU")
    assert reproduce(["ik", "--device", "cuda", "--results", str(tmp_path)]) == 2
    assert "argument --device: device='cuda'" in capsys.readouterr().err


def test_a_grid_goes_on_on_other_hardware(tmp_path: Path, trained: list[GridCell]) -> None:
    half = cells_of("mico", "ik", ["mlp", "flow"], [1], [0.0], [0], 30, 0.0, "bfloat16")
    list(run_grid(half, tmp_path, 1))
    whole = cells_of("mico", "ik", ["mlp", "flow"], [1, 2], [0.0], [0], 30)
    known = [as_known(cell, tmp_path) for cell in whole]
    assert known == [*half, *whole[2:]]
    on_gpu = cells_of("mico", "ik", ["mlp", "flow"], [1, 2], [0.0], [0], 30, device="cuda")
    assert [as_known(cell, tmp_path) for cell in on_gpu] == [*half, *on_gpu[2:]]
    trained.clear()
    cells = list(run_grid(known, tmp_path, 1))
    assert trained == whole[2:]
    page = render(
        {"title": "T", "robot": "mico", "task": "ik", "epochs": 30, "claims": []}
        | {"cells": [*cells, result(half[0])]}
    )
    assert "30 of the paper's 100 epochs, products between hidden layers in bfloat16" in page
    assert "in 1 of 3 cells" in page
    origin = {"provenance": {"machine": {"gpu": "A GPU"}}}
    page = render(
        {"title": "T", "robot": "mico", "task": "ik", "epochs": 100, "claims": []}
        | {"cells": [result(cell) | origin for cell in on_gpu]}
    )
    assert "; 100 epochs, on a GPU (A GPU). Size k" in page


def test_other_pages_come_from_their_figures() -> None:
    spread = distances(np.array([0.001, 0.003]))
    assert spread["median"] == pytest.approx(2.0)
    figures = {
        "title": "In use",
        "accuracy": [
            {
                "robot": "mico",
                "model": "shipped",
                "millimetres": dict.fromkeys(("raw", "one_step", "two_steps", "as_used"), spread),
            }
        ],
        "prediction": [
            {"robot": "mico", "model": "shipped", "latency_ms": 0.0421, "batch_us": 2.5}
        ],
        "cost": [],
        "success": [],
    }
    page = kinematics.render(figures)
    assert "| mico | shipped | 2 / 2.98 |" in page
    assert "| mico | shipped | 0.042 | 2.5 |" in page
    row = {"robot": "mico", "gain": 1.0, "per_joint": [0.001] * 4}
    rows = [
        {**row, "feed_forward": "analytic", "rms": 0.004},
        {**row, "feed_forward": "mlp", "rms": 0.001},
    ]
    assert "| mlp | 1.00 | 4.00x |" in tracking.render({"title": "Tracking", "rows": rows})


@pytest.mark.parametrize(
    ("wrapper", "used_in"), [(False, "environment"), (True, "LearnedIKAction")]
)
def test_a_policy_is_evaluated_with_a_model(wrapper: bool, used_in: str) -> None:
    from saver_envs.modelling.shipped import shipped_model

    model = shipped_model("jaco")
    found = kinematics._success("jaco", "jaco-push", "shipped", model, 2, 2, wrapper)
    assert (found["used_in"], found["refinement"], found["episodes"]) == (used_in, 2, 2)
    assert found["success"] == 1.0


@pytest.fixture
def short_campaign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """20 s of the MICO instead of 800: as many samples, nearer to one another."""
    from saver_envs.modelling import datasets
    from saver_envs.modelling.arms.description import Campaign

    short = Campaign(6, 3, 8.0, 1, cut=2.0, window=50, keep_every=1)
    monkeypatch.setattr(datasets, "campaign_of", lambda _: short)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


@pytest.mark.slow
def test_a_real_cell_and_a_search(tmp_path: Path, short_campaign: None) -> None:
    from saver_envs.modelling.datasets import samples_of, twin_data_set
    from saver_envs.modelling.models import Training
    from saver_envs.modelling.search import search

    cell = GridCell("mico", "ik", "cgan", 1, 0.2, 0, epochs=1)
    found = grid._run(cell, tmp_path)
    assert read_result(tmp_path, cell) == found
    assert found["task_space_mm"]["refined"]["median"] <= found["task_space_mm"]["raw"]["median"]
    assert 0 < found["latency_ms"] < 100
    inputs, outputs = samples_of(twin_data_set("mico").train.first(600), "id")
    trials = search("mlp", "mico", "id", (inputs, outputs), Training(epochs=1), 2)
    assert [one["epochs"] for one in trials] == [1, 1]
    assert all(np.isfinite(one["validation_rmse"]) for one in trials)


@pytest.mark.slow
def test_the_time_of_training_is_shared_out(
    tmp_path: Path, short_campaign: None, capsys: pytest.CaptureFixture[str]
) -> None:
    figures = tmp_path / "time.json"
    few = ["--samples", "600", "--epochs", "1", "--tasks", "id", "--models", "mlp", "cgan"]
    assert reproduce(["modelling", *few, "--json", str(figures)]) == 0
    rows = json.loads(figures.read_text())["rows"]
    assert [(one["model"], one["samples"], one["epochs"]) for one in rows] == [
        ("mlp", 600, 1),
        ("cgan", 600, 1),
    ]
    for one in rows:
        assert sum(one["shares"].values()) == pytest.approx(1)
        assert all(one["shares"][part] > 0 for part in training_time.PARTS)
        assert one["cpu_minutes"] > 0
    page = capsys.readouterr().out
    assert "| inverse dynamics | cgan | 600 | 1 |" in page
    assert reproduce(["modelling", "--from", str(figures)]) == 0
    assert "| inverse dynamics | cgan | 600 | 1 |" in capsys.readouterr().out


def test_a_search_for_the_weight_of_the_loop_tries_each_with_the_same_seeds() -> None:
    from saver_envs.modelling.models import Training
    from saver_envs.modelling.search import loop_space, search

    random = np.random.default_rng(0)
    inputs, outputs = random.normal(size=(200, 3)), random.normal(size=(200, 4))
    space = loop_space("bigan", [0.1, 1.0], 5)
    assert space is not None
    trials = search("bigan", "mico", "ik", (inputs, outputs), Training(epochs=1), 5, space)
    tried = sorted((one["settings"]["loop_weight"], one["settings"]["seed"]) for one in trials)
    assert tried == [(0.1, 0), (0.1, 1), (1.0, 0), (1.0, 1)]
    assert len({one["validation_rmse"] for one in trials}) == 4


def test_a_search_never_trains_the_same_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    import saver_envs.modelling.search as module
    from saver_envs.modelling.models import Training

    widths = (128, 256)
    space = {"layers": (3,), "width": widths, "activation": ("relu", "leaky_relu"), "leak": (0.1,)}
    monkeypatch.setattr(module, "ARCHITECTURES", space)
    random = np.random.default_rng(0)
    samples = random.normal(size=(60, 3)), random.normal(size=(60, 4))
    for trials in (3, 9):
        training = Training(epochs=1)
        found = module.search("mlp", "mico", "ik", samples, training, trials, module.ARCHITECTURES)
        settings = [tuple(one["settings"].values()) for one in found]
        assert len(set(settings)) == len(settings) == min(trials, 4)
    assert set(settings) == {
        (3, width, *rest) for width in widths for rest in (("relu", "-"), ("leaky_relu", 0.1))
    }


@pytest.mark.parametrize(
    ("model", "weights", "trials", "message"),
    [
        ("cgan", [0.1], 1, "model='cgan' has no loop: choose one of bigan, dualgan"),
        ("bigan", [-0.1], 1, "loop_weight=-0.1"),
        ("bigan", [0.1, 1.0], 1, "trials=1: must be at least one per weight, 2"),
    ],
)
def test_wrong_searches_are_named(
    model: str, weights: list[float], trials: int, message: str
) -> None:
    from saver_envs.modelling.search import loop_space

    with pytest.raises(ValueError, match=message):
        loop_space(model, weights, trials)
