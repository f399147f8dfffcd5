"""`saver dataset`: every kind, both formats, and mistakes of the user."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import ROOT, Saver, read_json

minari = pytest.importorskip("minari")
pytest.importorskip("pyarrow")

ENV = ("--env", "JacoPush-v0", "--episodes", 3, "--env-kwargs", "max_episode_steps=6")
DUAL = ("--env", "DualJacoPush-v0", *ENV[2:])


def test_expert(saver: Saver, sets: Path, tmp_path: Path) -> None:
    result = saver("dataset", "expert", *ENV, "--json", tmp_path / "set.json")
    assert result.status == 0, result.err
    dataset = minari.load_dataset("saver/JacoPush-v0/expert-v0")
    assert (dataset.total_episodes, dataset.total_steps) == (3, 18)
    about = dataset.storage.metadata["saver"]
    figures = read_json(tmp_path / "set.json")
    assert figures["folder"] == str(sets / "saver/JacoPush-v0/expert-v0")
    assert about.items() <= figures.items()
    assert (about["seed"], about["policy"], len(about["world"])) == (1_000_000, "expert", 16)
    assert figures["steps"] == 18
    again = saver("dataset", "expert", *ENV)
    assert again.status == 2
    assert "exists: choose another name" in again.err


def test_medium_elsewhere(saver: Saver, sets: Path, tmp_path: Path) -> None:
    words = ("--policy", "jaco-push", "--noise", 0.5, "--name", "mine/noisy-v3")
    result = saver("dataset", "medium", *ENV, *words, "--output", tmp_path / "other")
    assert result.status == 0, result.err
    assert (tmp_path / "other" / "mine" / "noisy-v3").is_dir()
    assert not sets.exists()
    about = minari.MinariDataset(tmp_path / "other/mine/noisy-v3/data").storage.metadata
    assert about["saver"]["noise"] == 0.5
    assert about["algorithm_name"] == "policy jaco-push with noise of 0.5"


def test_advised(saver: Saver, sets: Path, tmp_path: Path) -> None:
    json = tmp_path / "set.json"
    words = ("--teacher", "jaco-push", "--advice", "early", "--budget", 9)
    result = saver("dataset", "advised", *DUAL, *words, "--json", json)
    assert result.status == 0, result.err
    (first, *_) = minari.load_dataset("saver/DualJacoPush-v0/advised-v0").iterate_episodes()
    assert first.infos["advised"].shape == (7, 2)
    figures = read_json(json)
    assert (figures["teacher"], figures["budget"]) == ("jaco-push", 9)
    assert figures["advised_share"] == 9 / 18


def test_advised_by_the_own_expert_by_default(saver: Saver, sets: Path, tmp_path: Path) -> None:
    result = saver("dataset", "advised", *ENV, "--json", tmp_path / "set.json")
    assert result.status == 0, result.err
    figures = read_json(tmp_path / "set.json")
    assert (figures["teacher"], figures["advice"]) == ("scripted:JacoPush-v0", "mc-act")
    assert figures["threshold"] == 1.0
    assert 0 < figures["advised_share"] < 1


def test_advised_by_the_expert_of_all_arms(saver: Saver, sets: Path) -> None:
    result = saver("dataset", "advised", *DUAL, "--teacher", "expert", "--advice", "early")
    assert result.status == 0, result.err
    (first, *_) = minari.load_dataset("saver/DualJacoPush-v0/advised-v0").iterate_episodes()
    assert first.infos["advised"][1:].all()


def test_replay(saver: Saver, sets: Path, run_dir: Path) -> None:
    result = saver("dataset", "replay", run_dir, "--episodes", 3)
    assert result.status == 0, result.err
    dataset = minari.load_dataset("saver/JacoPush-v0/replay-v0")
    assert (dataset.total_episodes, dataset.total_steps) == (3, 30)
    assert dataset.storage.metadata["saver"]["run_steps"] == 40
    assert dataset.recover_environment().spec.max_episode_steps == 10


def test_lerobot(saver: Saver, tmp_path: Path) -> None:
    words = ("--format", "lerobot", "--size", 64, 48, "--cameras", "overhead")
    words = (*words, "--instruction", "Push the cube to its target.")
    result = saver("dataset", "expert", *ENV, *words, "--output", tmp_path / "lerobot")
    assert result.status == 0, result.err
    info = read_json(tmp_path / "lerobot" / "meta" / "info.json")
    assert (info["total_episodes"], info["total_frames"]) == (3, 18)
    assert "observation.images.overhead" in info["features"]


CASES = {
    "no kind": (["dataset"], ["KIND"]),
    "unknown kind": (["dataset", "best"], ["'best'", "expert"]),
    "no environment": (["dataset", "expert"], ["--env"]),
    "policy of another size": (
        ["dataset", "medium", *DUAL, "--policy", "jaco-push"],
        ["--policy", "'jaco-push'", "observation 56"],
    ),
    "noise below 0": (["dataset", "medium", *ENV, "--noise", -1], ["--noise", "noise=-1", "0 or"]),
    "noise of an expert": (["dataset", "expert", *ENV, "--noise", 1], ["--noise"]),
    "unknown teacher": (["dataset", "advised", *ENV, "--teacher", "jaco"], ["--teacher", "'jaco'"]),
    "unknown strategy": (["dataset", "advised", *ENV, "--advice", "late"], ["'late'", "early"]),
    "strategy of a learner": (
        ["dataset", "advised", *ENV, "--advice", "ibrl"],
        ["--advice", "'ibrl'", "critics"],
    ),
    "no critics": (["dataset", "advised", *ENV, "--advice", "mc-q"], ["mc-q", "critics"]),
    "seed below 0": (["dataset", "expert", *ENV, "--seed", -1], ["--seed", "0 or more"]),
    "name of Minari": (["dataset", "expert", *ENV, "--name", "a b"], ["a b"]),
    "no run": (["dataset", "replay", "nowhere"], ["RUN_DIR", "nowhere"]),
    "pictures of a replay": (["dataset", "replay", "run", "--format", "lerobot"], ["--format"]),
    "nowhere": (["dataset", "expert", *ENV, "--format", "lerobot"], ["--output"]),
    "odd size": (
        ["dataset", "expert", *ENV, "--format", "lerobot", "--size", 63, 48, "--output", "set"],
        ["size=(63, 48)", "even"],
    ),
    "unknown camera": (
        [
            *("dataset", "expert", *ENV, "--format", "lerobot", "--output", "set"),
            "--cameras",
            "top",
        ],
        ["'top'", "overhead"],
    ),
}


@pytest.mark.parametrize(("words", "wanted"), CASES.values(), ids=CASES)
def test_mistakes(
    words: list[object],
    wanted: list[str],
    saver: Saver,
    sets: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    result = saver(*words)
    assert result.status == 2
    assert len(result.err.strip().splitlines()) == 1, result.err
    for text in wanted:
        assert text in result.err
    assert not list(tmp_path.rglob("*.mp4"))


def test_the_help_names_the_noise(saver: Saver) -> None:
    from saver_advisors.datasets.actors import MEDIUM_NOISE

    assert f"(default: {MEDIUM_NOISE:g})" in saver("dataset", "medium", "--help").out


def test_the_page(saver: Saver, sets: Path) -> None:
    """The command and the program of docs/datasets.md that read and play again."""
    page = (ROOT / "docs" / "datasets.md").read_text()
    (program,) = re.findall(r"^```python\n(.*?)^```", page, flags=re.DOTALL | re.MULTILINE)
    assert saver("dataset", "expert", *ENV).status == 0
    names: dict[str, Any] = {}
    exec(compile(program, "docs/datasets.md", "exec"), names)
    assert names["truncated"]
    last = {key: rows[-1] for key, rows in names["episode"].observations.items()}
    for key, values in names["observation"].items():
        np.testing.assert_array_equal(values, last[key], strict=True)
