"""Worlds that vary, from the command line: evaluated and trained in, and recorded."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from shutil import copyfile
from typing import Any

import pytest
from commands import Saver, read_json, tiny_train
from tiny_runs import TINY_RUN

from saver_advisors.cli.policies import options_that_fit
from saver_advisors.evaluation.episodes import EpisodeOutcomes
from saver_advisors.policies.files import WEIGHTS_DIR, load_teacher, read_networks, save_policy
from saver_advisors.reporting.errors import UsageError
from saver_advisors.training import run as training_run
from saver_advisors.training.launch import train
from saver_advisors.training.settings import RunConfig
from saver_envs.randomization import Choice, Uniform
from saver_envs.registration import varied_in

PUSH = "JacoPush-v0"
SIZES = {"object_size": {"uniform": [0.04, 0.09]}}


@pytest.mark.parametrize(
    ("words", "option"),
    [
        (["--randomization", "wide"], "wide"),
        (["--randomization", "held-out:object_size"], "held-out:object_size"),
        (["--randomization", "held-out:all"], "held-out:all"),
        (
            ["--env-kwargs", "randomization={object_size: [0.04, 0.09]}"],
            {"object_size": [0.04, 0.09]},
        ),
    ],
)
def test_evaluations_record_option_and_distributions(
    saver: Saver, tmp_path: Path, words: list[str], option: Any
) -> None:
    file = tmp_path / "result.json"
    common = ("evaluate", "--env", PUSH, "--policy", "random", "--episodes", 2, "--json", file)
    result = saver(*common, *words, "--env-kwargs", "max_episode_steps=3")
    assert result.status == 0, result.err
    figures = read_json(file)
    assert figures["env_kwargs"] == {"randomization": option, "max_episode_steps": 3}
    assert figures["randomization"] == varied_in(PUSH, {"randomization": option}) != {}
    assert f"randomization={option}" in result.out
    # What is recorded can be passed again, and means the same.
    again = {"randomization": figures["randomization"]}
    assert varied_in(PUSH, again) == figures["randomization"]


def test_evaluations_in_equal_worlds_record_nothing(saver: Saver, tmp_path: Path) -> None:
    file = tmp_path / "result.json"
    words = ("evaluate", "--env", PUSH, "--policy", "random", "--episodes", 1, "--json", file)
    assert saver(*words, "--randomization", "none").status == 0
    assert "randomization" not in read_json(file)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("wild", "must be one of none, mild, wide, held-out:NAME, held-out:all"),
        ("held-out:person_mass", "this environment has held-out ranges of object_size"),
    ],
)
def test_unknown_presets_are_refused(saver: Saver, name: str, message: str) -> None:
    result = saver("evaluate", "--env", PUSH, "--policy", "random", "--randomization", name)
    assert result.status == 2
    assert "saver evaluate: error: argument --env-kwargs: randomization=" in result.err
    assert message in result.err


def test_training_evaluates_in_the_same_worlds_and_records_them(
    saver: Saver, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    used: list[Mapping[str, Any]] = []
    evaluate = training_run.evaluate_policy

    def keep(*arguments: Any, **options: Any) -> EpisodeOutcomes:
        used.append(options["env_kwargs"])
        return evaluate(*arguments, **options)

    monkeypatch.setattr(training_run, "evaluate_policy", keep)
    folder, file = tmp_path / "run", tmp_path / "student.safetensors"
    words = tiny_train(folder)
    words += ["--randomization", "held-out:object_mass"]
    assert saver(*words).status == 0
    option = {"max_episode_steps": 10, "randomization": "held-out:object_mass"}
    assert used
    assert all(one == option for one in used)
    record = read_json(folder / "run.json")
    varied = {"object_mass": {"uniform": [0.8, 1.2]}}
    assert record["config"]["env_kwargs"] == option
    assert record["randomization"] == varied
    assert saver("export", folder, "--path", file, "--episodes", 2).status == 0
    card = read_networks(file)[1]
    assert card.env_kwargs == option
    assert card.notes["randomization"] == varied
    assert "held-out:object_mass" in card.environment


def test_mappings_reach_settings_from_everywhere(saver: Saver, tmp_path: Path) -> None:
    import yaml

    settings = tmp_path / "settings.yml"
    values = {
        **TINY_RUN.to_mapping(),
        "env_kwargs": {"randomization": {"object_size": [0.04, 0.09]}},
    }
    settings.write_text(yaml.safe_dump(values))
    text = "randomization={object_size: [0.04, 0.09]}"
    starts = (
        ("train", "--env", PUSH, "--env-kwargs", text),
        ("train", "--env", PUSH, "--set", f"env_kwargs.{text}"),
        ("train", "--config", settings),
    )
    for words in starts:
        result = saver(*words, "--print-config")
        assert result.status == 0, result.err
        options = yaml.safe_load(result.out)["env_kwargs"]
        assert options["randomization"] == {"object_size": [0.04, 0.09]}
        assert varied_in(PUSH, options) == SIZES


def test_a_policy_that_observes_pending_motion_says_where_it_fits(
    saver: Saver, tmp_path: Path
) -> None:
    options = {"max_episode_steps": 10, "observe_pending_motion": True}
    train(replace(TINY_RUN, env_kwargs=options), tmp_path / "run", progress=False)
    words = ("evaluate", "--env", PUSH, "--policy", tmp_path / "run", "--episodes", 2)
    result = saver(*words)
    assert result.status == 2
    assert "pass --env-kwargs observe_pending_motion=true" in result.err
    assert saver(*words, "--env-kwargs", "observe_pending_motion=true").status == 0
    policy = str(tmp_path / "run")
    for kwargs in ({}, {"observe_pending_motion": True}):
        fitting = options_that_fit(policy, PUSH, {"rated": True, **kwargs})
        assert fitting == {"rated": True, "observe_pending_motion": True}
    assert options_that_fit("jaco-push", PUSH, {}) == {}
    with pytest.raises(UsageError, match=r"does not fit DualJacoPush-v0.*action 6$"):
        options_that_fit(policy, "DualJacoPush-v0", {})


def test_distributions_of_python_survive_the_record(tmp_path: Path) -> None:
    """A dataclass within the settings must not turn into a mapping of its fields."""
    given = {"object_size": Uniform(0.04, 0.09), "action_delay": Choice((0, 1))}
    config = replace(TINY_RUN, env_kwargs={"max_episode_steps": 10, "randomization": given})
    assert RunConfig.from_mapping(json.loads(json.dumps(config.to_mapping()))) == config
    train(config, tmp_path / "run", progress=False)
    record = read_json(tmp_path / "run" / "run.json")
    expected = {**SIZES, "action_delay": {"choice": [0, 1]}}
    assert record["config"]["env_kwargs"]["randomization"] == expected
    assert record["randomization"] == expected


def test_rows_are_measured_again_when_weights_have_changed(saver: Saver, tmp_path: Path) -> None:
    found, policy = tmp_path / "worlds.json", tmp_path / "policy.safetensors"
    words = ["benchmark", "worlds", "--policies", policy, "--env", PUSH, "--json", found]
    words += ["--worlds", "none", "mild", "--episodes", 2]

    def rows() -> list[Any]:
        result = saver(*words)
        assert result.status == 0, result.err
        rows: list[Any] = read_json(found)["rows"]
        return rows

    copyfile(WEIGHTS_DIR / "jaco-push.safetensors", policy)
    first = rows()
    assert [one["under"] for one in first] == ["none", "mild"]
    assert rows() == first  # with the same times: nothing was measured
    teacher, card = load_teacher(policy), read_networks(policy)[1]
    save_policy(policy, teacher, replace(card, seed=card.seed + 1))
    again = rows()
    assert again[0]["weights"] != first[0]["weights"]
    assert again[0]["wall_clock_s"] != first[0]["wall_clock_s"]
