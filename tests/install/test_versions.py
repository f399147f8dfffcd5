"""The wheel with the lowest and the newest versions of its dependencies, on each Python."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import fresh_install
import pytest
import version_matrix
from packaging.requirements import Requirement
from packaging.version import Version

ROOT = fresh_install.ROOT
THIS = f"{sys.version_info.major}.{sys.version_info.minor}"
PINNED = {
    requirement.name.lower().replace("_", "-"): Version(next(iter(requirement.specifier)).version)
    for line in (ROOT / "constraints.txt").read_text().splitlines()
    if line and not line.startswith("#")
    for requirement in [Requirement(line)]
}


@pytest.mark.parametrize("environment", ["base", "train", "all"])
def test_every_requirement_has_a_lower_bound_up_to_the_tested_version(environment: str) -> None:
    bounds = version_matrix.lower_bounds(environment)
    assert {"numpy", "mujoco", "gymnasium"} <= set(bounds)
    assert ("torch" in bounds) == (environment != "base")
    late = {
        name: bound
        for name, bound in bounds.items()
        if Version(bound) > PINNED[name.lower().replace("_", "-")]
    }
    assert not late


def test_lowest_versions_are_the_bounds_of_the_project(tmp_path: Path) -> None:
    *_, file = version_matrix.pip_options("train", "lowest", "2.13.0", tmp_path)
    lines = Path(file).read_text().splitlines()
    assert f"numpy=={version_matrix.lower_bounds()['numpy']}" in lines
    assert len(lines) == len(version_matrix.lower_bounds("train"))
    *_, file = version_matrix.pip_options("train", "newest", "2.13.0", tmp_path)
    assert Path(file).read_text() == "torch==2.13.0\n"
    *_, file = version_matrix.pip_options("base", "newest", None, tmp_path)
    assert Path(file).read_text() == ""


def test_a_requirement_without_a_lower_bound_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = (ROOT / "pyproject.toml").read_text().replace('"rich>=14.0"', '"rich<16"')
    (tmp_path / "pyproject.toml").write_text(text)
    monkeypatch.setattr(version_matrix, "ROOT", tmp_path)
    with pytest.raises(ValueError, match=r"'rich<16' in pyproject\.toml: expected NAME>="):
        version_matrix.lower_bounds()


def test_an_interpreter_of_another_version_does_not_count(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "python3.99").symlink_to(sys.executable)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    assert not version_matrix.runs("3.99")
    assert not version_matrix.runs("3.98")
    (tmp_path / f"python{THIS}").symlink_to(sys.executable)
    assert version_matrix.runs(THIS)


def test_classifiers_name_the_pythons_that_are_tried() -> None:
    text = (ROOT / "pyproject.toml").read_text()
    for python in version_matrix.PYTHONS:
        assert f'"Programming Language :: Python :: {python}"' in text
    assert f'requires-python = ">={version_matrix.PYTHONS[0]}"' in text


@pytest.mark.long
@pytest.mark.parametrize("versions", version_matrix.VERSIONS)
@pytest.mark.parametrize("environment", ["base", "train"])
@pytest.mark.parametrize("python", version_matrix.PYTHONS)
def test_the_wheel_works(
    python: str, environment: str, versions: str, wheel: Path, tmp_path: Path
) -> None:
    if not version_matrix.runs(python):
        pytest.skip(f"python{python} is not on PATH")
    if environment == "train" and python != THIS:
        pytest.skip("another build of PyTorch has several gigabytes: tools/version_matrix.py")
    # PyTorch as tested: the newest would bring the CUDA libraries along.
    trial = version_matrix.try_out(
        environment, versions, python, wheel, tmp_path / "trial", str(PINNED["torch"])
    )
    assert not trial.failures, version_matrix.describe(trial)


@pytest.mark.long
def test_the_sdist_installs(wheel: Path, tmp_path: Path) -> None:
    (sdist,) = wheel.parent.glob("*.tar.gz")
    programs = fresh_install.install("base", sdist, tmp_path / "venv")
    script = tmp_path / "rollouts.py"
    script.write_text(version_matrix.ROLLOUTS)
    command = [str(programs / "python"), "-I", str(script)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_the_wheel_has_every_file_of_the_packages(wheel: Path) -> None:
    tracked = subprocess.run(
        ["git", "ls-files", "saver_envs", "saver_advisors"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    ).stdout.split()
    assert set(tracked) <= set(zipfile.ZipFile(wheel).namelist())
