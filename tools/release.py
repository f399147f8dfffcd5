"""The checklist of a release, a line per check:

    python tools/release.py                       # all of them; dist/ then has what to publish
    python tools/release.py --only version paper  # some of them

The exit status is 1 if a check fails. `docs/releases.md` says what else a release needs.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import xml.etree.ElementTree as ElementTree
import zipfile
from collections.abc import Callable, Iterable
from datetime import datetime
from fnmatch import fnmatch
from pathlib import Path, PurePosixPath

import fresh_install
import yaml
from fresh_install import ROOT

#: Largest files that may be published; PyPI refuses files above 100 MB.
LARGEST_MB = {".whl": 40, ".gz": 60}
#: Reports of `make test` and `make test-long`.
REPORTS = (".reports/test.xml", ".reports/test-long.xml")
#: The sections and the length that the Journal of Open Source Software asks for.
PAPER_SECTIONS = (
    "Summary",
    "Statement of need",
    "State of the field",
    "Software design",
    "Research impact statement",
    "AI usage disclosure",
    "Acknowledgements",
    "References",
)
PAPER_WORDS = (750, 1750)
PAPER_FIELDS = ("title", "tags", "authors", "affiliations", "date", "bibliography")
#: Endings of our own code and text.
OWN = {".js", ".py", ".md", ".j2", ".yml", ".typed"}


class CheckFailed(Exception):
    """A check of the release failed; the message says why."""


def require(condition: object, message: str) -> None:
    """Raise `CheckFailed` with the message unless the condition holds."""
    if not condition:
        raise CheckFailed(message)


def run(root: Path, *command: str) -> str:
    """Run a command in the checkout; return what it printed.

    :raises CheckFailed: if its status is not 0; with the last line that it printed.
    """
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    lines = (done.stdout + done.stderr).strip().splitlines() or ["nothing printed"]
    require(done.returncode == 0, f"{' '.join(command)}: {lines[-1]}")
    return done.stdout


def released_version(root: Path) -> str:
    """Return the version of pyproject.toml."""
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))
    return str(project["project"]["version"])


def check_version(root: Path) -> str:
    """pyproject.toml, CITATION.cff, the changelog and the tag name the same version and date."""
    version = released_version(root)
    require(re.fullmatch(r"\d+\.\d+\.\d+", version), f"pyproject.toml: {version!r} is not X.Y.Z")
    citation = yaml.safe_load((root / "CITATION.cff").read_text(encoding="utf-8"))
    require(
        str(citation["version"]) == version,
        f"CITATION.cff has version {citation['version']}, pyproject.toml {version}",
    )
    changelog = (root / "CHANGELOG.md").read_text(encoding="utf-8")
    heading = re.search(rf"^## \[{re.escape(version)}\] - (\S+)$", changelog, re.MULTILINE)
    require(heading, f"CHANGELOG.md has no section '## [{version}] - YYYY-MM-DD'")
    assert heading is not None
    between = changelog.partition("## [Unreleased]")[2].partition("\n## [")[0]
    require(not between.strip(), "CHANGELOG.md still has lines under [Unreleased]")
    date = str(citation.get("date-released"))
    require(date == heading[1], f"CITATION.cff has date-released {date}, CHANGELOG.md {heading[1]}")
    return version


def check_tree(root: Path) -> str:
    """All files are committed."""
    changed = run(root, "git", "status", "--porcelain").splitlines()
    require(not changed, f"{len(changed)} files are not committed, such as {changed[:1]}")
    return run(root, "git", "rev-parse", "--short", "HEAD").strip()


def check_pages(root: Path) -> str:
    """The generated pages are those that the code and the results give."""
    run(root, sys.executable, "-m", "reproduction", "pages", "--no-pictures", "--check")
    return "up to date"


def check_tests(root: Path) -> str:
    """`make test` and `make test-long` passed after the last commit."""
    committed = float(run(root, "git", "log", "-1", "--format=%ct"))
    found = 0
    for name in REPORTS:
        file = root / name
        require(file.is_file(), f"{name} is missing: run `make test` and `make test-long`")
        for suite in ElementTree.parse(file).getroot().iter("testsuite"):
            started = datetime.fromisoformat(suite.attrib["timestamp"]).timestamp()
            require(started >= committed, f"{name} is older than the last commit")
            wrong = int(suite.attrib["failures"]) + int(suite.attrib["errors"])
            require(wrong == 0, f"{name}: {wrong} tests failed")
            found += int(suite.attrib["tests"]) - int(suite.attrib["skipped"])
    require(found, f"{' and '.join(REPORTS)} have no test that ran")
    return f"{found} passed"


def check_citation(root: Path) -> str:
    """CITATION.cff follows its schema."""
    program = "from cffconvert.cli.cli import cli; cli()"
    run(root, sys.executable, "-c", program, "--validate", "-i", str(root / "CITATION.cff"))
    return "valid"


def check_paper(root: Path) -> str:
    """paper.md has the fields, sections and length of JOSS; every citation has its entry."""
    _, front, body = (root / "paper.md").read_text(encoding="utf-8").split("---\n", 2)
    missing = [name for name in PAPER_FIELDS if not yaml.safe_load(front).get(name)]
    require(not missing, f"the front matter of paper.md lacks {missing}")
    sections = re.findall(r"^# (.+)$", body, re.MULTILINE)
    require(sections == list(PAPER_SECTIONS), f"paper.md has the sections {sections}")
    words = len(re.findall(r"[A-Za-z0-9][\w.'-]*", re.sub(r"^#.*$|\[[^]]*@[^]]*\]", "", body,
                                                           flags=re.MULTILINE)))  # fmt: skip
    least, most = PAPER_WORDS
    require(least <= words <= most, f"paper.md has {words} words, JOSS asks for {least} to {most}")
    cited = set(re.findall(r"@([\w-]+)", body))
    bibliography = (root / "paper.bib").read_text(encoding="utf-8")
    entries = set(re.findall(r"^@\w+\{([\w-]+),", bibliography, re.MULTILINE))
    require(cited == entries, f"cited or listed only: {sorted(cited ^ entries)}")
    return f"{words} words, {len(entries)} references"


def check_build(root: Path) -> str:
    """The sdist builds, and the wheel from it; both have this version and a permitted size."""
    shutil.rmtree(root / "dist", ignore_errors=True)
    try:
        fresh_install.build(root / "dist")
    except RuntimeError as error:
        raise CheckFailed(str(error).strip().splitlines()[-1]) from error
    version, sizes = released_version(root), []
    for file in sorted((root / "dist").iterdir()):
        require(file.name.startswith(f"saver_envs-{version}"), f"{file.name} is not of {version}")
        size, largest = file.stat().st_size / 1e6, LARGEST_MB[file.suffix]
        require(size <= largest, f"{file.name} has {size:.1f} MB, at most {largest} are permitted")
        sizes.append(f"{file.name} {size:.1f} MB")
    return ", ".join(sizes)


def check_metadata(root: Path) -> str:
    """Package indexes accept the metadata, and the wheel has nothing that does not belong there."""
    wheel, sdist = built(root)
    run(root, sys.executable, "-m", "twine", "check", "--strict", str(wheel), str(sdist))
    # W002: a licence beside its meshes and in the metadata, and the settings of `saver train` for
    # both of its ways; W009: two packages.
    program = "from check_wheel_contents.__main__ import main; main()"
    run(root, sys.executable, "-c", program, "--ignore", "W002,W009", str(wheel))
    with tarfile.open(sdist) as archive:
        names = {PurePosixPath(name).parts[1] for name in archive.getnames() if "/" in name}
    absent = {"tests", "docs", "tools", "NOTICE", "CITATION.cff", "paper.md"} - names
    require(not absent, f"the sdist lacks {sorted(absent)}")
    return "accepted"


def check_licences(root: Path) -> str:
    """Every asset of the wheel is named in NOTICE, or has a card with its licence."""
    with zipfile.ZipFile(built(root)[0]) as archive:
        names = archive.namelist()
    assets, bare = assets_of(names), unlicensed(names, root)
    require(not bare, f"neither NOTICE nor a card has the licence of {bare}")
    return f"{len(assets)} assets"


def built(root: Path) -> tuple[Path, Path]:
    """Return wheel and sdist of dist/.

    :raises CheckFailed: if there is not one of each.
    """
    wheels, sdists = list(root.glob("dist/*.whl")), list(root.glob("dist/*.tar.gz"))
    require(len(wheels) == len(sdists) == 1, "dist/ must have a wheel and an sdist: --only build")
    return wheels[0], sdists[0]


def assets_of(names: Iterable[str]) -> list[str]:
    """Return the files of a wheel that are neither code, text nor metadata."""
    return [
        name
        for name in names
        if ".dist-info/" not in name
        and PurePosixPath(name).suffix not in OWN
        and PurePosixPath(name).name != "LICENSE"
    ]


def unlicensed(names: Iterable[str], root: Path) -> list[str]:
    """Return the assets without a licence.

    Weights are ours and need a card with a line on the licence beside them; everything else must
    match a path in NOTICE.

    :param names: of the files of a wheel.
    :param root: the checkout.
    """
    notice = (root / "NOTICE").read_text(encoding="utf-8")
    patterns = re.findall(r"saver_\w+/[\w./*-]+\.\w+", notice)
    found = []
    for name in assets_of(names):
        if name.endswith(".safetensors"):
            path = root / name
            cards = [path.with_suffix(".md"), path.with_name("README.md")]
            text = "".join(card.read_text("utf-8") for card in cards if card.is_file())
            if "Licence:" not in text:
                found.append(name)
        elif not any(fnmatch(name, pattern) for pattern in patterns):
            found.append(name)
    return found


CHECKS: dict[str, Callable[[Path], str]] = {
    "version": check_version,
    "tree": check_tree,
    "pages": check_pages,
    "tests": check_tests,
    "citation": check_citation,
    "paper": check_paper,
    "build": check_build,
    "metadata": check_metadata,
    "licences": check_licences,
}


def main(arguments: list[str] | None = None) -> int:
    """Make the checks, and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=CHECKS, default=list(CHECKS), metavar="CHECK")
    args = parser.parse_args(arguments)
    failed = 0
    for name in args.only:
        try:
            print(f"ok    {name}: {CHECKS[name](ROOT)}", flush=True)
        except CheckFailed as error:
            failed += 1
            print(f"FAIL  {name}: {error}", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
