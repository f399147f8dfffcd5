"""`saver benchmark submit`: each rule that it checks, and what it leaves."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import pytest
from run_files import valid_content

from saver_advisors.benchmark.submission import conflicts, read_checked, violations
from saver_advisors.cli import main

ROOT = Path(__file__).resolve().parents[2]
TASK = "JacoPush-v0"
BY = ("--by", "A. Author", "--link", "https://example.org/mine")


def changed(path: str, value: Any) -> dict[str, Any]:
    """A valid result, but for one entry."""
    content = copy.deepcopy(valid_content(TASK, "Mine", 0))
    *outer, last = path.split("/")
    place: Any = content
    for key in outer:
        place = place[int(key) if isinstance(place, list) else key]
    place[int(last) if isinstance(place, list) else last] = value
    return content


def write(folder: Path, content: dict[str, Any], name: str = "") -> Path:
    folder.mkdir(exist_ok=True)
    path = folder / f"{name or content['name']}.json"
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize(
    ("path", "value", "told"),
    [
        ("task", "JacoPsh-v0", "task 'JacoPsh-v0' is unknown (did you mean JacoPush-v0?)"),
        ("task", "no.such.module:Id-v0", "task 'no.such.module:Id-v0' is unknown"),
        ("config/env_id", "MicoPush-v0", "config.env_id='MicoPush-v0' must be the task"),
        ("row", "<b>Mine</b>", "row='<b>Mine</b>' must be up to 60 letters"),
        ("config/env_kwargs", {"object_mass": 0.1}, 'config.env_kwargs={"object_mass": 0.1} must'),
        ("world", "0123456789abcdef", "world='0123456789abcdef' must be "),
        ("final/world", None, "final.world=None must be "),
        ("finished", False, "finished=false must be true"),
        ("config/total_steps", 600_000, "ends at 500,000 steps; must end at total_steps=600,000"),
        ("config/total_steps", 499_000, "must end at total_steps=499,000, or up to an episode in"),
        ("config/total_steps", float("inf"), "budget: an entry is missing or invalid"),
        ("config/eval_every", 0, "curve: an entry is missing or invalid"),
        ("teacher_steps", None, "teacher_steps=None must be the environment steps before the run"),
        ("demonstration_steps", -1, "demonstration_steps=-1 must be"),
        ("config/seed", 4, "config.seed=4 must be that of the run, 0"),
        ("seed", 9_999_999, "seed=9999999 must be from 0 to"),
        ("config/eval_every", 50_000, "eval_every 50000 not 25000"),
        ("config/eval_episodes", 50, "eval_episodes 50 not 100"),
        ("config/eval_seed", None, "eval_seed None not 10000"),
        ("final", None, "no final episodes"),
        ("final/seed", 500, "final seed 500 not 0"),
        ("final/episodes", 50, "final episodes 50 not 500"),
        ("curve/3/steps", 99_000, "curve: must have an evaluation every 25,000 steps"),
        ("curve/3/steps", 20_000, "curve: an entry is missing or invalid"),
        ("curve/3/wall_clock_s", 1.0, "curve: wall_clock_s must not fall"),
        ("curve/3/success_rate", 0.123, "curve.success_rate=0.123 must be a share of 100"),
        ("final/success_rate", 0.9001, "final.success_rate=0.9001 must be a share of 500"),
        ("final/success_rate", float("nan"), "final.success_rate=nan must be a share"),
        ("final/safe_success_rate", 0.95, "final.safe_success_rate=0.95 must be at most"),
        ("final/success_rate_2cm", 0.95, "final.success_rate_2cm=0.95 must be at most"),
        ("final/cost_means/cost_collision", 0, "final.safe_success_rate must be 0.9"),
        ("final/ci95", [0.5, 1.0], "final.ci95=[0.5, 1.0] must be [0.8706, 0.9233] for 0.9"),
        ("final/success_rate_2cm", "most", "rates: an entry is missing or invalid"),
        ("provenance", {}, "provenance.versions lacks python, mujoco, gymnasium, numpy"),
        (
            "provenance/commit",
            None,
            "must have a commit of this repository, or versions.saver_envs",
        ),
        ("submission", {"by": "<i>", "link": None}, "submission.by='<i>' must be up to 60"),
        ("submission", {"by": "A", "link": "javascript:x"}, "submission.link='javascript:x' must"),
    ],
)
def test_a_violated_rule_is_named(path: str, value: Any, told: str) -> None:
    assert any(one.startswith(told) or told in one for one in violations(changed(path, value)))


def test_a_run_by_the_protocol_is_valid() -> None:
    assert violations(valid_content(TASK, "Mine", 0)) == []
    # The number of environments of a run and of its last block may leave a few steps over.
    content = changed("curve/19/steps", 500_016)
    assert violations(content) == []
    assert violations(changed("submission", {"by": "A. B.", "link": "https://x.org/?a=1"})) == []


@pytest.mark.parametrize(("steps", "valid"), [(500_000, True), (400_000, False)])
def test_the_checkpoint_is_the_one_that_was_best(steps: int, valid: bool) -> None:
    content = valid_content(TASK, "Mine", 0)
    content["chosen"] = {**content["final"], "steps": steps}
    told = violations(content)
    assert told == ([] if valid else [told[0]])
    assert valid or told[0].startswith("chosen.steps=400,000 must be 500,000, the checkpoint")


@pytest.mark.parametrize("text", ["{", "[]", '{"kind": "evaluation"}', '{"kind": "training-run"}'])
def test_a_file_that_is_no_result_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "some.json"
    path.write_text(text)
    valid, refused = read_checked([path, tmp_path / "absent.json"])
    assert not valid
    assert [one.file for one in refused] == ["some.json", "absent.json"]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({}, "has task, row and seed of first: remove that one to replace it"),
        ({"seed": 1, "config": {"lr": 2}}, "differs from first in lr: runs of a method differ"),
        ({"seed": 1, "submission": {"by": "B"}}, "has the row of first, by A: give it another row"),
        ({"seed": 1}, None),
        ({"row": "Other", "config": {"lr": 2}}, None),
    ],
)
def test_the_runs_of_a_method_belong_together(change: dict[str, Any], told: str | None) -> None:
    first = {"task": TASK, "row": "Mine", "seed": 0, "config": {"lr": 1}, "file": "first"}
    first["submission"] = {"by": "A"}
    found = conflicts([first, {**first, "file": "second", **change}])
    assert [(one.file, one.reason.startswith(str(told))) for one in found] == (
        [("second", True)] if told else []
    )


def test_results_are_submitted_all_or_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    results, board = tmp_path / "results", Path("docs/results/leaderboard")
    files = [str(write(results, valid_content(TASK, "Mine 2.0", seed))) for seed in range(3)]
    submit = ["benchmark", "submit", *BY, "--", *files]
    assert main(submit) == 2
    assert "argument --to: needed here" in capsys.readouterr().err
    board.parent.mkdir(parents=True)
    wrong = write(results, {**valid_content(TASK, "Mine 2.0", 3), "finished": False}, "wrong")
    assert main([*submit, str(wrong)]) == 2
    told = capsys.readouterr().err.splitlines()
    assert told[0].startswith("wrong.json: finished=false must be true")
    assert "1 violations of the protocol" in told[-1]
    assert not board.exists()
    assert main(submit) == 0
    assert "Mine 2.0 has 3 of 5 seeds in JacoPush-v0" in capsys.readouterr().out
    names = [f"JacoPush-v0-Mine-2.0-seed{seed}.json" for seed in range(3)]
    assert sorted(path.name for path in board.iterdir()) == names
    copied = json.loads((board / names[0]).read_text())
    assert copied.pop("submission") == {"by": "A. Author", "link": "https://example.org/mine"}
    assert copied == json.loads(Path(files[0]).read_text())
    # A second time they are there already; further seeds are added.
    assert main(submit) == 2
    assert "seed of JacoPush-v0-Mine-2.0-seed0.json: remove that one" in capsys.readouterr().err
    more = [str(write(results, valid_content(TASK, "Mine 2.0", seed))) for seed in (3, 4)]
    assert main(["benchmark", "submit", *more, *BY]) == 0
    assert "of 5 seeds" not in capsys.readouterr().out


@pytest.mark.parametrize(
    "words",
    [
        ("--by", "A|B"),
        ("--by", "[A](b)"),
        ("--by", "A", "--link", "example.org"),
        ("--by", "A", "--link", "https://example.org/) <b>"),
    ],
)
def test_names_and_links_are_plain(
    tmp_path: Path, words: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path, valid_content(TASK, "Mine", 0))
    with pytest.raises(SystemExit):
        main(["benchmark", "submit", str(path), *words, "--to", str(tmp_path / "to")])
    assert words[-1] in capsys.readouterr().err


@pytest.mark.slow
def test_an_algorithm_of_one_file_is_trained_and_submitted(tmp_path: Path) -> None:
    """By the protocol, but for a short budget: an episode in each environment."""
    example = ROOT / "docs" / "examples" / "td3_her.py"
    words = ["benchmark", "run", "--env", TASK, "--algo", f"{example}:TD3HER", "--seed", "0"]
    assert main([*words, "--steps", "800", "--output", str(tmp_path / "results")]) == 0
    [path] = (tmp_path / "results").glob("*.json")
    assert main(["benchmark", "submit", str(path), *BY, "--to", str(tmp_path / "to")]) == 0
    [content], refused = read_checked((tmp_path / "to").iterdir())
    assert not refused
    assert (content["row"], content["submission"]["by"]) == ("TD3HER", "A. Author")
