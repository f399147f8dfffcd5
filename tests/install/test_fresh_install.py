"""The wheel in fresh virtual environments: each documented command, with and without its extra."""

from __future__ import annotations

import re
from pathlib import Path

import fresh_install
import pytest
from fresh_install import ROOT

from saver_advisors.cli import COMMANDS as SAVER_COMMANDS


def outcomes(environment: str, programs: Path, folder: Path) -> dict[str, fresh_install.Outcome]:
    """Run all commands, and return what they left behind, by command."""
    found = fresh_install.run_commands(environment, programs, folder)
    wrong = [f"{one.command}: status {one.status}: {one.said}" for one in found if not one.right]
    assert not wrong, "\n".join(wrong)
    return {one.command: one for one in found}


@pytest.mark.slow
def test_the_base_wheel_lists_environments_and_names_missing_extras(
    base_programs: Path, tmp_path: Path
) -> None:
    found = outcomes("base", base_programs, tmp_path)
    assert sum(one.complete for one in found.values()) == len(SAVER_COMMANDS) + 4 + 5
    for command, extra in (
        ("saver evaluate --env JacoPush-v0 --policy jaco-push", "train"),
        ("saver train --env JacoPush-v0 --output runs/push", "train"),
        ("saver experiments run", "train"),
        ("saver benchmark run", "train"),
        ("saver pose photo.png", "pose"),
        ("saver model train", "modelling"),
    ):
        refused = [one for one in found.values() if not one.complete]
        said = next(one.said for one in refused if one.command.startswith(command))
        assert f"pip install 'saver-envs[{extra}]'" in said, said


@pytest.mark.long
@pytest.mark.parametrize(
    "environment", ["train", "logging", "datasets", "pose", "modelling", "all"]
)
def test_every_documented_command_runs_with_its_extras(
    environment: str, wheel: Path, tmp_path: Path
) -> None:
    (tmp_path / "work").mkdir()
    programs = fresh_install.install(environment, wheel, tmp_path / "venv")
    outcomes(environment, programs, tmp_path / "work")


def test_the_list_has_every_documented_command() -> None:
    listed = {_named(command) for _, command in fresh_install.COMMANDS}
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
    blocks = [
        block
        for page in pages
        for block in re.findall(r"^```bash\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE)
    ]
    lines = [line.strip() for block in blocks for line in block.splitlines()]
    documented = {_named(line) for line in lines if line.startswith("saver ")}
    assert len(documented) > 10
    # They take hours, or are listed under the name of the extra that brings them.
    hours = {"saver model data", "saver model search", "saver train-pose"}
    assert documented - listed - hours == set()


def _named(command: str) -> str:
    """``saver benchmark run`` of a whole command line."""
    words = command.split()
    grouped = words[1] in ("benchmark", "experiments", "model")
    return " ".join(words[: 3 if grouped else 2])
