"""The transfer benchmark on tiny settings: who is tried where, what is told, what is shown."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import pytest

from reproduction.program import main as reproduce
from reproduction.transfer.attempts import (
    EXPERT,
    OBJECT_SIZE,
    TITLES,
    Attempt,
    by_kind,
    conditions,
)
from reproduction.transfer.failures import PICK_CAUSES, PUSH_CAUSES, Failure
from reproduction.transfer.transfer_command import (
    STUDENTS,
    attempts,
    entrants,
    paper_rows,
    render,
)
from saver_advisors.policies.files import WEIGHTS_DIR, load_policy
from saver_advisors.reporting.errors import UsageError
from saver_envs.registration import make_episodes


def test_the_papers_rows_add_up() -> None:
    """40, 0, 38 and 30 of 50 (Table 5.4), and the causes that the text below it counts."""
    rows = paper_rows()
    assert {key: row["successes"] for key, row in rows.items()} == {
        ("push", "advised"): 40,
        ("push", "scratch"): 0,
        ("pick", "advised"): 38,
        ("pick", "scratch"): 30,
    }
    for (task, _), row in rows.items():
        assert set(row["causes"]) <= set(PUSH_CAUSES if task == "push" else PICK_CAUSES)
        if row["causes"]:
            assert row["successes"] + sum(row["causes"].values()) == row["trials"] == 50


@pytest.mark.parametrize("task", TITLES)
def test_every_condition_can_be_built_and_differs_in_what_it_says(task: str) -> None:
    several = conditions(task)
    assert several[0].name == "home"
    assert several[-1].name == "all"
    for one in several:
        attempt = Attempt(task, one, "expert", EXPERT)
        made = make_episodes(attempt.env_id, **attempt.options)
        made.reset()
        usual = make_episodes(attempt.env_id).task
        for option in ("object_size", "object_friction", "object_mass", "object_damping"):
            own = getattr(made.worlds.tasks[0], option)
            assert own == one.randomization.get(option, getattr(usual, option)), (one.name, option)
        assert ("noise" in one.words) == ("sensor_noise" in one.randomization)
        assert (not one.randomization) == (one.name in ("home", "raw", "mico"))
    assert ("object_size" in several[-1].randomization) == (task == "push")
    if task == "push":
        assert several[-1].randomization["object_size"] == OBJECT_SIZE == 0.09


def test_who_tries() -> None:
    labels = list(entrants("push", None))
    assert labels == ["advised", "teachers side by side", "scripted expert"]
    path = WEIGHTS_DIR / "dual-jaco-push.safetensors"
    words = ["scratch=side-by-side:jaco-push", str(path)]
    assert entrants("push", words) == {
        "scratch": "side-by-side:jaco-push",
        str(path): str(path),
    }
    assert entrants("pick", []) == {}
    with pytest.raises(UsageError, match="different labels"):
        entrants("push", ["a=expert", "a=random"])


def test_the_expert_tries_some_conditions_and_students_all() -> None:
    everything = attempts(argparse.Namespace(push=None, pick=None, conditions=None))
    of_push = [one for one in everything if one.task == "push"]
    names = [one.name for one in conditions("push")]
    assert [one.condition.name for one in of_push if one.label == "advised"] == names
    tried = {one.condition.name for one in of_push if one.policy == EXPERT}
    assert {"mico", "all"} <= tried < set(names)


def test_each_kind_is_shown_once_and_the_strangest_condition_first() -> None:
    home, _, mico, *_ = conditions("push")
    failures = [None, Failure("slid_away", 3, 0), None, Failure("collided", 5, 0)]
    found: list[Any] = [
        (Attempt("push", home, "a", "a"), [], failures),
        (Attempt("push", mico, "a", "a"), [], [Failure("slid_away", 9, 0), None]),
        (Attempt("push", mico, "b", "b"), [], [Failure("timed_out", 9, 0), None]),
        (Attempt("push", mico, "c", EXPERT), [], [Failure("diverged", 9, 0)]),
    ]
    assert list(by_kind(found)) == [
        ("slid_away", 1, 0),
        ("success", 1, 1),
        ("timed_out", 2, 0),
        ("collided", 0, 3),
    ]


def test_the_whole_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    figures, page = tmp_path / "transfer.json", tmp_path / "docs" / "transfer.md"
    page.parent.mkdir()
    words = "transfer --trials 3 --seed 4 --conditions all mico --push advised="
    policy = str(WEIGHTS_DIR / "dual-jaco-push.safetensors")
    more = ["random", "--pick", "side-by-side:jaco-pick-and-place"]
    out = ["--json", str(figures), "--table", str(page)]
    assert reproduce([*f"{words}{policy}".split(), *more, *out]) == 0
    content = json.loads(figures.read_text())
    assert content["provenance"].keys() >= {"command", "commit", "versions", "machine"}
    assert str(WEIGHTS_DIR) not in figures.read_text()
    assert [(one["task"], one["condition"], one["label"]) for one in content["outcomes"]] == [
        ("push", "mico", "advised"),
        ("push", "mico", "random"),
        ("push", "all", "advised"),
        ("push", "all", "random"),
        ("pick", "mico", "side-by-side:jaco-pick-and-place"),
        ("pick", "all", "side-by-side:jaco-pick-and-place"),
    ]
    for one in content["outcomes"]:
        assert one["successes"] + sum(one["causes"].values()) == one["trials"] == 3
    text = page.read_text()
    assert "| Push | advised |" in text
    assert "| 40/50 | 10 slid away |" in text
    assert "| 30/50 | 12 weak grasp, 8 inaccurate |" in text
    assert "| object position | 0.003 | 0.005 |" in text
    assert [one["name"] for one in content["weights"]] == ["dual-jaco-push", "jaco-pick-and-place"]
    capsys.readouterr()
    assert reproduce(["transfer", "--from", str(figures)]) == 0
    assert capsys.readouterr().out.strip() == text.strip()


@pytest.mark.slow
def test_videos_show_what_happened(tmp_path: Path) -> None:
    from PIL import Image

    figures, videos = tmp_path / "transfer.json", tmp_path / "videos"
    words = "transfer --trials 1 --conditions mico --push random --pick"
    out = ["--json", str(figures), "--video-dir", str(videos), "--table", str(tmp_path / "t.md")]
    assert reproduce([*words.split(), *out]) == 0
    content = json.loads(figures.read_text())
    (shown,) = content["videos"]
    (outcome,) = content["outcomes"]
    assert [shown["kind"]] == [*outcome["causes"]]
    assert (shown["label"], shown["condition"], shown["seed"]) == ("random", "mico", 0)
    assert (videos / f"{shown['file']}.mp4").stat().st_size > 5000
    with Image.open(videos / f"{shown['file']}.webp") as clip:
        # Every second of 51 instants, and the last one held, which is one frame more or none.
        assert clip.n_frames >= 26  # type: ignore[attr-defined]
    assert f"](videos/{shown['file']}.webp)" in (tmp_path / "t.md").read_text()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--conditions", "moon"], "condition 'moon' is unknown"),
        (["--push", "jaco-push"], "does not fit DualMicoPush-v0"),
        (["--push", "nobody"], "policy 'nobody' is unknown"),
        (["--trials", "0"], "must be 1 or more"),
    ],
)
def test_mistakes_are_named(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        status = reproduce(["transfer", "--conditions", "mico", *words])
    except SystemExit as error:
        status = int(error.code or 0)
    assert status == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize("text", ['{"rows": [', "[]", '{"kind": "speed"}'])
def test_a_file_that_is_no_measurement_is_named(
    text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "cut.json"
    path.write_text(text)
    assert reproduce(["transfer", "--from", str(path)]) == 2
    assert str(path) in capsys.readouterr().err


def test_shipped_weights_are_those_that_were_measured() -> None:
    docs = Path(__file__).resolve().parents[2] / "docs"
    measured = json.loads((docs / "results" / "transfer.json").read_text())["weights"]
    assert {one["name"] for one in measured} >= set(STUDENTS.values())
    for one in measured:
        card = load_policy(one["name"]).card
        assert (card.steps, card.commit) == (one["steps"], one["commit"]), one["name"]


def test_the_page_is_that_of_the_file() -> None:
    """docs/transfer.md was rendered from docs/results/transfer.json."""
    docs = Path(__file__).resolve().parents[2] / "docs"
    figures = json.loads((docs / "results" / "transfer.json").read_text())
    assert (docs / "transfer.md").read_text() == render(figures, "images/transfer")
    for one in figures["videos"]:
        for suffix in (".mp4", ".webp"):
            assert (docs / "images/transfer" / f"{one['file']}{suffix}").is_file()
