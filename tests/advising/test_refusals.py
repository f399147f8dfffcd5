"""What cannot work is refused before a step is taken, with what would."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stable_baselines3 import A2C, PPO
from tiny_runs import read_config, write_settings
from toy_arms import GOAL, OBSERVATION, make_teacher, make_vec_env
from toy_runs import BLOCK, save_teacher, settings, start, steps_taken

from saver_advisors.advising import AdvisingCallback, build_advised, make_advisor
from saver_advisors.training.checkpoint import _checksum
from saver_advisors.training.settings import AdviceConfig, RunConfig

NAN, INF = float("nan"), float("inf")


def refused(folder: Path, advice: dict[str, Any], message: str, **changes: Any) -> None:
    """The run's start raises, and no environment was told to do anything."""
    envs: list[Any] = []
    with pytest.raises((ValueError, TypeError), match=message):
        start(settings(advice, **changes), folder / "run", envs=envs)
    assert sum(steps_taken(env) for env in envs) == 0


def advice(folder: Path, **more: Any) -> dict[str, Any]:
    return {"strategy": "mc-q", "teacher": save_teacher(folder), "budget": BLOCK, **more}


@pytest.mark.parametrize("threshold", [-0.1, NAN, INF])
@pytest.mark.parametrize("strategy", ["mc-q", "mc-act", "mc-actabs", "early-mc"])
def test_thresholds(tmp_path: Path, strategy: str, threshold: float) -> None:
    given = advice(tmp_path, strategy=strategy, threshold=threshold)
    refused(tmp_path, given, r"advice.threshold=.* must be (finite|0 or more)")
    with pytest.raises(ValueError, match="threshold"):
        make_advisor(strategy, make_teacher(), 10, n_arms=2, threshold=threshold)


@pytest.mark.parametrize("budget", [-1, 1.5, True, "many"])
def test_budgets(tmp_path: Path, budget: Any) -> None:
    refused(tmp_path, advice(tmp_path, budget=budget), r"advice.budget=.* must be (0 or|a whole)")
    with pytest.raises((ValueError, TypeError), match="must"):
        make_advisor("early", make_teacher(), budget, n_arms=2)


def test_a_teacher_of_another_action_size(tmp_path: Path) -> None:
    wide = save_teacher(tmp_path, name="wide", action_size=3)
    message = r"'wide' has actions of size 3, which do not divide the student's action of size 4"
    refused(tmp_path, advice(tmp_path, teacher=wide), message)
    refused(tmp_path, advice(tmp_path, teacher=[save_teacher(tmp_path), wide]), "same sizes")


def test_a_teacher_of_another_observation_size(tmp_path: Path) -> None:
    inputs = (("observation", OBSERVATION + 1), ("desired_goal", GOAL))
    other = save_teacher(tmp_path, name="other", inputs=inputs)
    refused(tmp_path, advice(tmp_path, teacher=other), r"\['other', 'other'\] does not fit this")


@pytest.mark.parametrize("strategy", ["mc-q", "early-mc"])
def test_a_teacher_without_critics(tmp_path: Path, strategy: str) -> None:
    blind = save_teacher(tmp_path, name="blind", critics=0)
    message = (
        rf"'{strategy}' compares Q values, but teacher \['blind'\] has no critics: use 'early', "
        "'mc-act' or 'mc-actabs', or a teacher saved with its critics"
    )
    refused(tmp_path, advice(tmp_path, teacher=blind, strategy=strategy), message)
    pair = [save_teacher(tmp_path), blind]
    refused(tmp_path, advice(tmp_path, teacher=pair, strategy=strategy), r"\['blind'\]")
    # Strategies that ask no critic of the teacher take it.
    start(settings(advice(tmp_path, teacher=blind, strategy="mc-act"), total_steps=BLOCK), tmp_path)


@pytest.mark.parametrize("algorithm", ["ppo", "a2c"])
def test_an_on_policy_algorithm(tmp_path: Path, algorithm: str) -> None:
    message = rf"algorithm='{algorithm}' must be one of .*td3.*need an off-policy algorithm"
    refused(tmp_path, advice(tmp_path), message, algorithm=algorithm)


@pytest.mark.parametrize("algorithm", [PPO, A2C])
def test_an_on_policy_algorithm_of_sb3(algorithm: Any) -> None:
    message = "cannot be advised.*Use an off-policy algorithm: DDPG, TD3, SAC, TQC"
    with pytest.raises(TypeError, match=message):
        build_advised(algorithm)
    env = make_vec_env(2)
    model = algorithm("MultiInputPolicy", env, n_steps=32)
    advisor = make_advisor("early", make_teacher(), 10, n_arms=2)
    with pytest.raises(TypeError, match=message):
        model.learn(16, callback=AdvisingCallback(advisor))
    assert steps_taken(env) == 0


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"strategy": "mcq"}, r"strategy='mcq' is unknown: use one of none, .*, random, .*ibrl"),
        ({"strategy": "no_such_module:Mine"}, "strategy='no_such_module:Mine' cannot be imported"),
        ({"strategy": "json:Mine"}, "strategy='json:Mine' cannot be imported"),
        ({"strategy": "json:JSONDecoder"}, "lacks name, decide: a strategy has name, needs"),
        ({"strategy": "early", "threshold": 0.1}, "'early' takes no threshold"),
        ({"strategy": "ibrl", "threshold": 0.1}, "'ibrl' takes no threshold"),
        ({"correcting": "mc-act"}, "correcting='mc-act' belongs to 'early-mc' only"),
        ({"settings": {"limit": 1}}, "'mc-q' takes no limit=1; its settings are threshold"),
        ({"settings": [1]}, r"advice.settings=\[1\] must be a mapping"),
        ({"compare": "quiet"}, "compare='quiet': must be one of noisy, noise-free"),
        ({"twin_minimum": 1}, "advice.twin_minimum=1 must be true or false"),
        ({"arms": 1}, "advice.arms=1 must be a list of whole numbers or null"),
        ({"arms": [2]}, r"arms=\[2\]: must be one or more of \[0, 1\]"),
        ({"teacher": []}, "advice.teacher=.* must be a name, or a list of one name per arm"),
        ({"teacher": 3}, "advice.teacher=3 must be a text or a list of texts"),
        ({"teacher": "jaco-pull"}, "policy 'jaco-pull' is unknown"),
    ],
)
def test_names_and_kinds(tmp_path: Path, more: dict[str, Any], message: str) -> None:
    refused(tmp_path, advice(tmp_path, **more), message)


def test_configurations_come_back_from_files(tmp_path: Path) -> None:
    config = RunConfig(
        "DualJacoPush-v0",
        advice=AdviceConfig(
            "random",
            ("jaco-push", "jaco-push"),
            100,
            settings={"probability": 0.1},
            arms=(0,),
            twin_minimum=False,
            demonstration_steps=10,
            cloning_updates=3,
        ),
    )
    for name in ("run.yaml", "run.json"):
        write_settings(config, tmp_path / name)
        assert read_config(tmp_path / name) == config
    assert np.isclose(config.advice.demonstration_fraction, 0.5)  # type: ignore[union-attr]


def test_a_checkpoint_from_before_a_setting_goes_on(tmp_path: Path) -> None:
    """Settings that are newer than a checkpoint have their defaults in it, and no others."""
    config = settings(advice(tmp_path, threshold=0.05))
    start(config, tmp_path / "run", stop_after_steps=BLOCK)
    path = tmp_path / "run" / "latest" / "state.json"
    state = json.loads(path.read_text())
    for name in ("arms", "settings", "bootstrap", "demonstration_steps", "twin_minimum"):
        del state["extra"]["config"]["advice"][name]
    del state["sha256"]
    path.write_text(json.dumps({**state, "sha256": _checksum(state)}))
    other = settings({**advice(tmp_path, threshold=0.05), "twin_minimum": False})
    with pytest.raises(ValueError, match=r"has another configuration .*twin_minimum"):
        start(other, tmp_path / "run", resume=True)
    assert start(config, tmp_path / "run", resume=True).finished
