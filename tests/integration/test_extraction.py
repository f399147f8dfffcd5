"""An extraction hands the person over from task to task and reports the outcome."""

from __future__ import annotations

import json
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from saver_advisors.cli import main
from saver_advisors.integration import extraction
from saver_advisors.integration.extraction import Extraction, ExtractionStep, extract
from saver_envs.people.bed import Bed
from saver_envs.people.contact_forces import FORCE_LIMITS
from saver_envs.people.limp_people import PEOPLE
from saver_envs.registration import EXTRACTION_IDS, make_episodes, task_and_settings
from saver_envs.tasks.contract import NoStart
from saver_envs.tasks.procedure import drawn_person, with_person

TASKS: list[Any] = [task_and_settings(env_id, {})[0] for env_id in EXTRACTION_IDS]


def points(episodes: Any, bed: Bed) -> np.ndarray:
    """Return where the person's joints are over the bed, without regard to the heading."""
    model = episodes.scene.model
    names = [model.site(index).name for index in range(model.nsite)]
    sites = [index for index, name in enumerate(names) if name.startswith("joint_")]
    places = episodes.simulation.site_position[0, sites] - bed.centre
    return np.linalg.norm(places[:, None] - places[None], axis=-1) + places[:, None, 2:][..., 0]


def test_a_person_lies_on_the_next_bed_as_the_last_task_left_them() -> None:
    person = drawn_person(TASKS[:1], np.random.default_rng(3))  # legs are straight
    seen = []
    for env_id, task in zip(EXTRACTION_IDS, TASKS, strict=True):
        episodes = make_episodes(env_id)
        episodes.worlds.tasks[0] = with_person(task, person)
        episodes.set_generator(0, np.random.default_rng(0))
        episodes.reset()
        seen.append(points(episodes, task.bed))
        assert task.pose_of(episodes.simulation, 0) == pytest.approx(person.pose, abs=1e-9)
        assert episodes.memory["friction"][0] == pytest.approx(person.friction)
    for one, other in pairwise(seen):
        np.testing.assert_allclose(one, other, atol=1e-6)


def test_persons_are_those_that_every_task_handles() -> None:
    drawn = [drawn_person(TASKS, np.random.default_rng(seed)) for seed in range(3)]
    for task in TASKS:
        assert {one.who for one in drawn} <= set(task.people)
    assert drawn[0] == drawn_person(TASKS, np.random.default_rng(0))
    with pytest.raises(NoStart, match="nobody is handled by all of"):
        drawn_person([TASKS[0], NobodyFits()], np.random.default_rng(0))  # type: ignore[list-item]


class NobodyFits:
    """Stands in for a task for people of whom there are none."""

    people = (len(PEOPLE),)
    name = "nobody"


@pytest.mark.parametrize("pose", [(0.0,) * 34, (float("nan"),) * 35])
def test_a_pose_that_is_none_is_refused(pose: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match=r"person_pose=.*must be 35 finite numbers"):
        task_and_settings(EXTRACTION_IDS[0], {"person_pose": pose})


def test_it_ends_with_the_task_that_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    played: list[tuple[str, list[int]]] = []

    def play(env_id: str, episodes: Any, *_: Any) -> list[ExtractionStep]:
        episodes.reset()
        played.append((env_id, list(range(episodes.n))))
        successes = [row > 0 for row in range(episodes.n)]
        forces = dict.fromkeys(FORCE_LIMITS, 1.0)
        return [ExtractionStep(env_id, one, True, 1.0, forces, ()) for one in successes]

    monkeypatch.setattr(extraction, "play_step", play)
    found = extract(dict.fromkeys(EXTRACTION_IDS, lambda seen: seen), [5, 6, 7])
    left = 3 - np.arange(len(EXTRACTION_IDS))
    assert [len(rows) for _, rows in played] == left[left > 0].tolist()
    assert [one.seed for one in found] == [5, 6, 7]
    assert found[0].outcome == f"{EXTRACTION_IDS[0]} failed: the goal was not reached"
    assert not found[0].completed and len(found[0].steps) == 1


@pytest.mark.slow
def test_the_command_reports_with_a_video(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    brief = partial(make_episodes, max_episode_steps=5)
    monkeypatch.setattr(extraction, "make_episodes", brief)
    words = ["run", "extraction", "--true-state", "--trials", "2", "--policy", "expert"]
    files = ["--report", str(tmp_path / "report"), "--json", str(tmp_path / "x.json")]
    assert main([*words, *files]) == 0
    assert "0 of 2 completed, from the true state" in capsys.readouterr().out
    told = json.loads((tmp_path / "x.json").read_text())
    assert [one["seed"] for one in told["people"]] == [0, 1]
    assert [row["people who began it"] for row in told["rows"]] == [2, *[0] * (len(TASKS) - 1)]
    assert told["people"][0]["steps"][0]["forces"].keys() == FORCE_LIMITS.keys()
    page = (tmp_path / "report" / "index.html").read_text()
    assert "lower leg" in page and 'src="extraction.mp4"' in page
    assert (tmp_path / "report" / "extraction.mp4").stat().st_size > 1000


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--true-state", "--apart"], "argument --apart: not for an extraction"),
        (["--true-state", "--policy", "jaco-push"], "'jaco-push' cannot play an extraction"),
    ],
)
def test_what_an_extraction_does_not_have_is_refused(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", "extraction", *words]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.long
def test_experts_extract_half_of_the_people() -> None:
    from saver_envs.experts import make_expert

    experts = {env_id: make_expert(env_id) for env_id in EXTRACTION_IDS}
    policies = {
        env_id: lambda seen, expert=one: expert.predict(seen)[0] for env_id, one in experts.items()
    }
    found: list[Extraction] = extract(policies, range(100, 116))
    assert sum(one.completed for one in found) >= 8
