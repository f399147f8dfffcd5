"""The snippets of the README and the tutorials run, in the order of the page; links work."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from textwrap import dedent

import pytest
import yaml
from commands import ROOT, TINY, Saver
from short_saver import shortened

PAGES = (
    "README.md",
    "docs/quick-start.md",
    "docs/interfaces.md",
    "docs/advising.md",
    "docs/your-own-strategy.md",
    "docs/variable-reward.md",
    "docs/worlds.md",
    "docs/learner.md",
    "docs/multi-agent.md",
    "docs/index.md",
    "docs/first-policy.md",
    "docs/your-own-algorithm.md",
    "docs/your-own-teacher.md",
    "docs/constraints.md",
    "docs/pose-in-the-loop.md",
    "docs/learned-ik.md",
    "docs/grid-on-a-cluster.md",
    "docs/reproducibility.md",
    "docs/viewer.md",
    "docs/limp-person.md",
)
#: Every page that a reader can come to.
READ = sorted(
    str(path.relative_to(ROOT))
    for path in (*ROOT.glob("docs/**/*.md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md")
)
#: The settings of a grid's runs that take a second.
TINY_GRID = {
    **yaml.safe_load("{" + ", ".join(word.replace("=", ": ") for word in TINY) + "}"),
    **{"total_steps": 40, "env_kwargs": {"max_episode_steps": 10}},
}
#: Tried elsewhere: they install, or take minutes.
ELSEWHERE = (
    "pip ",
    "make ",
    "saver --help",
    "saver demo",
    "saver COMMAND",
    "saver view --env JacoPush-v0 --control",
    "python docs/examples/",
    "export ",
    "python3 -m venv",
    "source ",
)


def blocks(page: str, language: str) -> list[str]:
    """The code of a page."""
    text = (ROOT / page).read_text()
    found = re.findall(rf"^( *)```{language}\n(.*?)^\1```", text, flags=re.DOTALL | re.MULTILINE)
    return [dedent(code) for _, code in found]


def commands(page: str) -> list[str]:
    """The commands of a page that are tried here."""
    text = "".join(blocks(page, "bash")).replace("\\\n", " ")
    return [line for line in text.splitlines() if line and not line.startswith(ELSEWHERE)]


def expanded(word: str, folder: Path) -> list[str]:
    """The files that a pattern matches, as a shell would give them."""
    return sorted(str(path) for path in folder.glob(word)) if "*" in word else [word]


def write_files(page: str, folder: Path) -> None:
    """Write a page's blocks with a title to the files that they are called."""
    found = re.findall(
        r'^```\w+ title="([\w.]+)"\n(.*?)^```', (ROOT / page).read_text(), re.DOTALL | re.MULTILINE
    )
    for name, text in found:
        (folder / name).write_text(SHORTER_FILES.get(name, str)(text))


def shorter_grid(text: str) -> str:
    """The grid of a page with tiny runs of one seed."""
    grid = yaml.safe_load(text)
    grid["final_episodes"] = 2
    for group in grid["groups"].values():
        group["settings"] |= TINY_GRID
        group["seeds"] = [0]
    return yaml.safe_dump(grid)


def shorter_search(text: str) -> str:
    """The search of a page with tiny runs of one seed."""
    search = yaml.safe_load(text)
    search["settings"] |= TINY_GRID
    return yaml.safe_dump({**search, "final_episodes": 2, "seeds": [0]})


SHORTER_FILES = {"grid.yml": shorter_grid, "search.yml": shorter_search}


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "python")])
def test_python(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    write_files(page, tmp_path)
    names: dict[str, object] = {}
    for code in blocks(page, "python"):
        exec(compile(code, page, "exec"), names)


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if commands(page)])
def test_commands(page: str, saver: Saver, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    write_files(page, tmp_path)
    (tmp_path / "runs").mkdir()
    for folder in ("zoo_configs", "docs"):
        (tmp_path / folder).symlink_to(ROOT / folder)
    for line in commands(page):
        program, command, *words = shlex.split(line, comments=True)
        assert program == "saver", line
        words = [file for word in words for file in expanded(word, tmp_path)]
        result = saver(*shortened([command, *words]))
        assert result.status == 0, f"{line}\n{result.err}"


@pytest.mark.parametrize("page", PAGES)
def test_make_targets_exist(page: str) -> None:
    makefile = (ROOT / "Makefile").read_text()
    for target in re.findall(r"^make ([a-z-]+)", "\n".join(blocks(page, "bash")), re.MULTILINE):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target


@pytest.mark.parametrize("page", READ)
def test_links_lead_somewhere(page: str) -> None:
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", (ROOT / page).read_text()):
        if not target.startswith("http"):
            assert ((ROOT / page).parent / target).exists(), target
