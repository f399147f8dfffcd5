"""Where results come from."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

import saver_advisors.reporting.provenance as module
from saver_advisors.reporting.provenance import (
    COMMIT_VARIABLE,
    VECTOR_INSTRUCTIONS,
    machine_in_words,
    portable_command,
    provenance,
    write_json_atomic,
)


def test_provenance_names_versions_and_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["/some/folder/saver", "train", "a b"])
    facts = json.loads(json.dumps(provenance()))
    assert facts["command"] == "saver train 'a b'"
    assert facts["versions"]["numpy"] == np.__version__
    assert facts["versions"]["torch"].split("+")[0] == torch.__version__.split("+")[0]
    assert set(facts["versions"]) >= {"python", "sb3", "mujoco", "gymnasium"}
    assert facts["machine"]["cores"] >= 1
    assert facts["machine"]["cpu"]
    assert set(facts["machine"]["vector_instructions"]) <= set(VECTOR_INSTRUCTIONS.values())


def test_a_machine_is_named_with_what_its_processor_can_do() -> None:
    older = {"cpu": "AMD EPYC", "cores": 2}
    assert machine_in_words(older) == "AMD EPYC, 2 cores"
    newer = older | {"vector_instructions": ["AVX2", "AVX-512"], "gpu": "NVIDIA H200"}
    assert machine_in_words(newer) == "AMD EPYC with AVX2 and AVX-512, 2 cores, NVIDIA H200"


def test_the_commit_is_that_of_our_own_checkout(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def git(*arguments: str) -> None:
        identity = ["-c", "user.name=a", "-c", "user.email=a@b"]
        subprocess.run(["git", "-C", str(tmp_path), *identity, *arguments], check=True)

    git("init", "-q")
    (tmp_path / "file").write_text("a")
    git("add", "file")
    git("commit", "-q", "-m", "first")
    monkeypatch.setattr(module, "REPOSITORY", tmp_path.resolve())
    commit = provenance()["commit"]
    assert len(commit) == 40
    (tmp_path / "file").write_text("b")
    assert provenance()["commit"] == f"{commit}-dirty"
    # A package installed inside somebody else's repository has no commit of ours.
    (tmp_path / "inner").mkdir()
    monkeypatch.setattr(module, "REPOSITORY", (tmp_path / "inner").resolve())
    assert provenance()["commit"] is None
    monkeypatch.setenv(COMMIT_VARIABLE, commit)
    assert provenance()["commit"] == commit


def test_json_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    write_json_atomic(path, {"value": 1})
    with pytest.raises(ValueError, match="nan"):
        write_json_atomic(path, {"value": float("nan")})
    assert json.loads(path.read_text()) == {"value": 1}
    assert [file.name for file in tmp_path.iterdir()] == ["a.json"]


def test_a_command_names_no_folder_of_the_machine() -> None:
    command = "/opt/bin/saver train --output /home/me/runs/push --set 'net_arch=[8,8]' runs/other"
    assert portable_command(command) == (
        "saver train --output push --set 'net_arch=[8,8]' runs/other"
    )
    assert portable_command(".venv/bin/saver envs") == "saver envs"
    assert (
        portable_command("saver train --set start_from=/r/two")
        == "saver train --set start_from=two"
    )
    assert portable_command("/clone/reproduction/__main__.py ik") == "python -m reproduction ik"
    assert portable_command("/x/saver_advisors/cli/__main__.py envs") == "saver envs"
