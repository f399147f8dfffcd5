"""The command line run in this process, and tiny runs to look at."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import torch

from saver_advisors.cli import main

ROOT = Path(__file__).resolve().parents[2]
TINY = (
    "net_arch=[8]",
    "batch_size=16",
    "gradient_steps=2",
    "n_envs=2",
    "buffer_size=400",
    "eval_every=20",
    "eval_episodes=2",
    "checkpoint_every=20",
)
"""Settings of a run that takes a second."""


class Result(NamedTuple):
    """What a command left behind."""

    status: int
    out: str
    err: str


Saver = Callable[..., Result]


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture
def saver(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Saver:
    """A function (words of the command line) -> Result."""
    # Wide enough that no table folds what a test looks for.
    monkeypatch.setenv("COLUMNS", "250")

    def run(*words: object) -> Result:
        arguments = [str(word) for word in words]
        monkeypatch.setattr(sys, "argv", ["saver", *arguments])
        capsys.readouterr()
        try:
            status = main(arguments)
        except SystemExit as error:
            status = int(error.code or 0)
        captured = capsys.readouterr()
        return Result(status, captured.out, captured.err)

    return run


def tiny_train(output: Path, *more: object) -> list[object]:
    """The words of a tiny training run: 40 steps of episodes of 10."""
    return [
        *("train", "--env", "JacoPush-v0", "--output", output, "--steps", 40, "--no-progress"),
        *("--env-kwargs", "horizon=10", "--set", *TINY, *more),
    ]


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished tiny run."""
    folder = tmp_path_factory.mktemp("runs") / "tiny"
    assert main([str(word) for word in tiny_train(folder)]) == 0
    return folder


def read_json(path: Path) -> dict[str, Any]:
    """A file that a command wrote."""
    content: dict[str, Any] = json.loads(path.read_text())
    return content
