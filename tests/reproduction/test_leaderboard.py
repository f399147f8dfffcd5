"""The leaderboard: its order, its marks, and what it leaves out."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from run_files import valid_content

from reproduction.pages.leaderboard import leaderboard_page

TASK, TWIN = "JacoPush-v0", "JacoPushDense-v0"
AUTHOR = {"by": "A. Author", "link": "https://example.org/mine"}


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """Baselines with five seeds, one with the dense reward, and a submission with two."""
    for folder in ("baselines", "leaderboard"):
        (tmp_path / folder).mkdir()
    for seed in range(5):
        put(tmp_path / "baselines", valid_content(TASK, "SAC + HER", seed, 0.5))
        put(tmp_path / "baselines", valid_content(TASK, "TQC + HER", seed, 0.7 + 0.02 * seed))
        put(tmp_path / "baselines", valid_content(TWIN, "PPO", seed, 0.6))
    for seed in range(2):
        mine = {**valid_content(TASK, "SAC + HER", seed, 0.98), "submission": AUTHOR}
        mine["teacher_steps"] = 600_000
        mine["config"]["train_env_kwargs"] = {"object_mass": 0.4, "contested_share": 0.4}
        put(tmp_path / "leaderboard", mine)
    return tmp_path


def put(folder: Path, content: dict[str, Any]) -> None:
    name = f"{content['task']}-{content['row']}-{content['seed']}.json"
    (folder / name).write_text(json.dumps(content))


def rows_of(text: str) -> list[list[str]]:
    """The cells of the only table of a page."""
    lines = [line for line in text.splitlines() if line.startswith("| ")][1:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_methods_are_sorted_and_marked(results: Path) -> None:
    text = leaderboard_page(results)
    assert text.count("\n## ") == 1
    assert f"## {TASK}\n" in text
    tqc, ppo, sac, mine = rows_of(text)
    assert tqc[:3] == ["TQC + HER", "baseline", "5"]
    assert tqc[3].startswith("0.740 [0.7")
    assert ppo[0] == "PPO"
    assert ppo[-1] == "dense reward"
    assert (sac[0], sac[3], sac[4], sac[5]) == (
        "SAC + HER",
        "0.500 [0.500, 0.500]",
        "0.400 [0.400, 0.400]",
        "0.300 [0.300, 0.300]",
    )
    # No success rate of 0.9 in half a million steps; twenty minutes, in the file's clock.
    assert sac[6] == "> 500,000 (5 of 5 never)"
    assert (sac[7], sac[8], sac[9]) == ("20.0 [20.0, 20.0]", "500,000", "-")
    # Two seeds: below the others, whatever the success, and not mixed with the baseline's.
    assert mine[:3] == ["[SAC + HER](https://example.org/mine)", "A. Author", "**2 of 5**"]
    assert (mine[8], mine[9]) == ("500,000, after 600,000", "`object_mass=0.4`")


def test_what_violates_a_rule_is_left_out_and_listed(results: Path) -> None:
    put(results / "leaderboard", {**valid_content(TASK, "Half", 0), "finished": False})
    (results / "leaderboard" / "cut.json").write_text("{")
    text = leaderboard_page(results)
    assert len(rows_of(text)) == 4
    assert f"- `{TASK}-Half-0.json`: finished=false must be true" in text
    assert "- `cut.json`: " in text


def test_an_empty_leaderboard_says_so(tmp_path: Path) -> None:
    text = leaderboard_page(tmp_path)
    assert "There are no results yet." in text
    assert "| method |" not in text
