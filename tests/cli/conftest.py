"""The command line run in this process, and tiny runs to look at."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
import torch
from commands import Result, Saver, tiny_train

from saver_advisors.cli import main


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


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished tiny run."""
    folder = tmp_path_factory.mktemp("runs") / "tiny"
    assert main([str(word) for word in tiny_train(folder)]) == 0
    return folder
