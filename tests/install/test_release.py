"""The checklist of a release: what holds in this checkout, and what each check refuses."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import zipfile
from pathlib import Path

import pytest
import release
from release import CheckFailed

ROOT = release.ROOT
RESULTS = ROOT / "docs" / "results"
HISTORY = "## [Unreleased]\n{unreleased}\n## [{version}] - 2026-12-01\n\n- The first one.\n"


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A folder that passes the checks of versions, paper and tests."""
    for name in ("pyproject.toml", "CITATION.cff", "NOTICE", "paper.md", "paper.bib"):
        shutil.copy(ROOT / name, tmp_path)
    citation = tmp_path / "CITATION.cff"
    citation.write_text(citation.read_text() + "date-released: 2026-12-01\n")
    version = release.released_version(tmp_path)
    (tmp_path / "CHANGELOG.md").write_text(HISTORY.format(unreleased="", version=version))
    git = ["git", "-c", "user.name=a", "-c", "user.email=a@b.c", "-C", str(tmp_path)]
    subprocess.run([*git, "init", "-q"], check=True)
    subprocess.run([*git, "add", "-A"], check=True)
    subprocess.run([*git, "commit", "-q", "-m", "all"], check=True)
    return tmp_path


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def test_versions_that_agree_pass(checkout: Path) -> None:
    assert release.check_version(checkout) == release.released_version(ROOT)


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("CITATION.cff", "version: 0.1.0", "version: 0.0.9", "CITATION.cff has version 0.0.9"),
        ("CITATION.cff", "2026-12-01", "2026-12-02", "date-released 2026-12-02, CHANGELOG"),
        ("CHANGELOG.md", "[0.1.0]", "[0.2.0]", "has no section"),
        ("CHANGELOG.md", "[Unreleased]\n", "[Unreleased]\n\n- More.\n", "still has lines"),
        ("pyproject.toml", 'version = "0.1.0"', 'version = "0.1"', "'0.1' is not X.Y.Z"),
    ],
)
def test_versions_that_differ_are_refused(
    checkout: Path, file: str, old: str, new: str, message: str
) -> None:
    edit(checkout / file, old, new)
    with pytest.raises(CheckFailed, match=re.escape(message)):
        release.check_version(checkout)


def test_the_citation_has_the_version_of_the_project() -> None:
    text = (ROOT / "CITATION.cff").read_text()
    assert f"\nversion: {release.released_version(ROOT)}\n" in text


def test_files_that_are_not_committed_are_refused(checkout: Path) -> None:
    assert release.check_tree(checkout)
    (checkout / "new.txt").write_text("new")
    with pytest.raises(CheckFailed, match="1 files are not committed"):
        release.check_tree(checkout)


def report(checkout: Path, *, failures: int = 0, year: int = 2099, tests: int = 5) -> None:
    for name in release.REPORTS:
        (checkout / name).parent.mkdir(exist_ok=True)
        (checkout / name).write_text(
            f'<testsuites><testsuite errors="0" failures="{failures}" skipped="1" '
            f'tests="{tests}" timestamp="{year}-01-01T00:00:00+00:00"/></testsuites>'
        )


def test_reports_of_the_tests_are_read(checkout: Path) -> None:
    with pytest.raises(CheckFailed, match=r"test\.xml is missing: run `make test`"):
        release.check_tests(checkout)
    report(checkout)
    assert release.check_tests(checkout) == "8 passed"
    report(checkout, failures=2)
    with pytest.raises(CheckFailed, match="2 tests failed"):
        release.check_tests(checkout)
    report(checkout, year=2001)
    with pytest.raises(CheckFailed, match="older than the last commit"):
        release.check_tests(checkout)
    report(checkout, tests=1)
    with pytest.raises(CheckFailed, match="no test that ran"):
        release.check_tests(checkout)


def test_make_writes_the_reports_that_are_read() -> None:
    makefile = (ROOT / "Makefile").read_text()
    assert all(f"--junitxml={name}" in makefile for name in release.REPORTS)


def test_the_paper_has_the_form_that_the_journal_asks_for() -> None:
    assert "references" in release.check_paper(ROOT)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("# Software design", "# Design", "has the sections"),
        ("bibliography: paper.bib", "", "lacks ['bibliography']"),
        ("[@torrey2013teaching]", "", "['torrey2013teaching']"),
        ("# Summary", "# Summary\n" + "word " * 1800, "words, JOSS asks for 750 to 1750"),
    ],
)
def test_another_form_is_refused(checkout: Path, old: str, new: str, message: str) -> None:
    edit(checkout / "paper.md", old, new)
    with pytest.raises(CheckFailed, match=re.escape(message)):
        release.check_paper(checkout)


def result(name: str) -> dict[str, object]:
    return dict(json.loads((RESULTS / f"{name}.json").read_text()))


def test_figures_of_the_paper_are_those_of_the_results() -> None:
    paper = " ".join((ROOT / "paper.md").read_text().split())
    push = result("DualJacoPush-v0-dual-jaco-push")
    pushers = result("DualJacoPush-v0-side-by-side-jaco-push")
    apart = result("DualJacoDistance-v0-dual-jaco-distance")
    carriers = result("DualJacoDistance-v0-side-by-side-jaco-pick-and-place")
    speed = json.loads((RESULTS / "speed.json").read_text())
    one, two = (
        next(
            row["steps_per_second"]
            for row in speed["rows"]
            if (row["env"], row["n_envs"], row["threads"]) == ("JacoPush-v0", 64, threads)
        )
        for threads in (1, 2)
    )
    ratio = speed["peers"]["ratios"][0]
    assert (ratio["env"], ratio["peer"]) == ("JacoPush-v0", "FetchPush-v4 (gymnasium-robotics)")
    programs = [
        program["result"] == "ok"
        for row in json.loads((RESULTS / "ecosystem.json").read_text())["rows"]
        for program in row["programs"]
    ]
    for sentence in (
        f"side by side succeed in {pushers['success_rate']:.3f} of {pushers['episodes']} episodes",
        f"for both arms in {push['success_rate']:.3f} of {push['episodes']};",
        f"{pushers['safe_success_rate']:.3f} and {push['safe_success_rate']:.3f}, so giving way",
        f"the figures are {carriers['success_rate']:.3f} and {apart['success_rate']:.3f}.",
        f"makes {one:,.0f} environment steps per second with 64 episodes, and {two:,.0f} on two",
        f"it is {ratio['ratio']:.1f} times as fast as `FetchPush-v4`",
        f"Of {len(programs)} programs of third-party libraries",
        f"{sum(programs)} work with the environments as they are",
    ):
        assert sentence in paper, sentence


def test_the_citation_follows_its_schema() -> None:
    pytest.importorskip("cffconvert")
    assert release.check_citation(ROOT) == "valid"


def test_an_invalid_citation_is_refused(checkout: Path) -> None:
    pytest.importorskip("cffconvert")
    edit(checkout / "CITATION.cff", "type: software", "type: program")
    with pytest.raises(CheckFailed):
        release.check_citation(checkout)


def tracked() -> list[str]:
    command = ["git", "ls-files", "saver_envs", "saver_advisors"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip("not a git checkout")
    return done.stdout.splitlines()


def test_every_asset_has_a_licence() -> None:
    assert len(release.assets_of(tracked())) > 20
    assert release.unlicensed(tracked(), ROOT) == []


def test_assets_without_a_licence_are_named(tmp_path: Path) -> None:
    (tmp_path / "NOTICE").write_text("Files: saver_envs/a/*.stl and saver_envs/b/body.npz")
    names = ["saver_envs/a/x.stl", "saver_envs/b/body.npz", "saver_envs/b/other.npz"]
    names += ["saver_envs/w/p.safetensors", "saver_envs/w/q.safetensors", "saver_envs/x.py"]
    (tmp_path / "saver_envs" / "w").mkdir(parents=True)
    (tmp_path / "saver_envs" / "w" / "p.md").write_text("- Licence: MIT")
    assert release.unlicensed(names, tmp_path) == [
        "saver_envs/b/other.npz",
        "saver_envs/w/q.safetensors",
    ]


def test_every_path_in_the_notice_exists() -> None:
    paths = re.findall(r"(?:saver_\w+|licenses|tools)/[\w./*-]*\w", (ROOT / "NOTICE").read_text())
    assert len(paths) > 5
    assert [path for path in paths if not list(ROOT.glob(path))] == []


@pytest.mark.slow
def test_indexes_accept_the_package(wheel: Path, tmp_path: Path) -> None:
    pytest.importorskip("twine")
    pytest.importorskip("check_wheel_contents")
    (tmp_path / "dist").symlink_to(wheel.parent)
    assert release.check_metadata(tmp_path) == "accepted"
    metadata = next(name for name in zipfile.ZipFile(wheel).namelist() if "/METADATA" in name)
    text = zipfile.ZipFile(wheel).read(metadata).decode()
    assert "License-Expression: MIT AND BSD-3-Clause AND Apache-2.0 AND CC0-1.0\n" in text
    assert "License-File: NOTICE\n" in text


def test_the_program_prints_a_line_per_check(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(_: Path) -> str:
        raise CheckFailed("because")

    monkeypatch.setattr(release, "CHECKS", {"good": lambda _: "fine", "bad": fails})
    assert release.main(["--only", "good"]) == 0
    assert release.main([]) == 1
    assert capsys.readouterr().out == "ok    good: fine\n" * 2 + "FAIL  bad: because\n"
