"""Every snippet of the README and the quick start runs, in the order of the page."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from commands import ROOT, TINY, Saver

PAGES = (
    "README.md",
    "docs/quick-start.md",
    "docs/interfaces.md",
    "docs/advising.md",
    "docs/your-own-strategy.md",
    "docs/variable-reward.md",
    "docs/worlds.md",
    "docs/learner.md",
)
#: What a snippet's command gets on top, so that it takes seconds: the last value of an argument
#: counts.
SHORTER = {
    "envs": [],
    "evaluate": ["--episodes", "2", "--env-kwargs", "max_episode_steps=10"],
    "train": [
        "--steps",
        "40",
        "--no-progress",
        "--env-kwargs",
        "max_episode_steps=10",
        "--set",
        *TINY,
    ],
    "curves": [],
    "export": ["--episodes", "2"],
}
#: Tried elsewhere: they install, or take minutes.
ELSEWHERE = (
    "pip ",
    "make ",
    "saver --help",
    "saver benchmark",
    "saver demo",
    "saver COMMAND",
    "export ",
)


def blocks(page: str, language: str) -> list[str]:
    """The code of a page."""
    text = (ROOT / page).read_text()
    return re.findall(rf"^```{language}\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)


def write_files(page: str, folder: Path) -> None:
    """Write a page's blocks with a title to the files that they are called."""
    found = re.findall(
        r'^```\w+ title="([\w.]+)"\n(.*?)^```', (ROOT / page).read_text(), re.DOTALL | re.MULTILINE
    )
    for name, text in found:
        (folder / name).write_text(text)


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_python(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    write_files(page, tmp_path)
    found = blocks(page, "python")
    assert found
    names: dict[str, object] = {}
    for code in found:
        exec(compile(code, page, "exec"), names)


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "bash")])
def test_commands(page: str, saver: Saver, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    write_files(page, tmp_path)
    (tmp_path / "runs").mkdir()
    (tmp_path / "zoo_configs").symlink_to(ROOT / "zoo_configs")
    lines = [line for code in blocks(page, "bash") for line in code.splitlines() if line]
    ours = [line for line in lines if not line.startswith(ELSEWHERE)]
    assert ours
    for line in ours:
        program, command, *words = shlex.split(line, comments=True)
        assert program == "saver", line
        more = [] if "--resume" in words else SHORTER[command]
        if "DualJacoPush-v0" in words and command == "train" and "--advice" not in words:
            more = [*more, "net_arch=[256,256,256]"]  # it starts as two teachers: as wide as they
        # A run of the snippet before is finished: going on with it does nothing more.
        result = saver(command, *words, *more, *(["--no-progress"] if "--resume" in words else []))
        assert result.status == 0, f"{line}\n{result.err}"


@pytest.mark.parametrize("page", PAGES)
def test_make_targets_exist(page: str) -> None:
    makefile = (ROOT / "Makefile").read_text()
    for target in re.findall(r"^make ([a-z-]+)", "\n".join(blocks(page, "bash")), re.MULTILINE):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target


@pytest.mark.parametrize("page", (*PAGES, "docs/index.md", "docs/architecture.md"))
def test_links_lead_somewhere(page: str) -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", (ROOT / page).read_text()):
        if not target.startswith("http"):
            assert ((ROOT / page).parent / target).exists(), target
