"""The programs of third-party libraries run as they are documented."""

from __future__ import annotations

import importlib.metadata
import subprocess
import sys
from pathlib import Path

import pytest

from reproduction.ecosystem.ecosystem_command import LIBRARIES, PROGRAMS, Library, render, tried
from saver_envs.files import cache_folder

ROOT = Path(__file__).resolve().parents[2]
HERE = [one for one in LIBRARIES if not one.requirements and not one.unresolved]
BESIDE = [one for one in LIBRARIES if one.requirements and not one.pin]


def name(library: Library) -> str:
    return library.package


@pytest.mark.slow
@pytest.mark.parametrize("library", HERE, ids=name)
def test_a_library_that_comes_with_us_works(library: Library, tmp_path: Path) -> None:
    for line in library.programs:
        words = line.format(root=ROOT).split()
        done = subprocess.run(
            [sys.executable, *words], cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr


@pytest.mark.long
@pytest.mark.parametrize("library", BESIDE, ids=name)
def test_a_library_that_installs_with_us_works(library: Library) -> None:
    row = tried(library, cache_folder("peers"))
    assert [run["result"] for run in row["programs"]] == ["ok"] * len(library.programs)


def test_every_program_has_a_row() -> None:
    listed = {Path(line).name for one in LIBRARIES for line in one.programs}
    assert {path.name for path in (ROOT / PROGRAMS).glob("*.py")} <= listed


def test_a_page_names_versions_results_and_pins() -> None:
    program = {"program": "one.py", "result": "ok", "seconds": 1.0}
    row = {"library": "One", "version": "2.0", "pin": "numpy<2", "programs": [program]}
    page = render({"title": "Third-party libraries", "rows": [row]})
    assert "| One | 2.0 | `one.py` | ok | numpy<2 |" in page


def test_packages_that_come_with_us_are_installed() -> None:
    for library in HERE:
        assert importlib.metadata.version(library.package)
