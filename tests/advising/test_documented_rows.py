"""The settings that the page on advising gives for each baseline build a learner."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from saver_advisors.advising import STRATEGIES
from saver_advisors.training.building import build_model
from saver_advisors.training.settings import RunConfig
from saver_envs.envs.sb3_vec_env import SaverVecEnv

PAGE = (Path(__file__).parents[2] / "docs" / "advising.md").read_text()
ROWS = re.findall(r"^\| ([^|`]+) \| `(\{strategy.*\})` \|$", PAGE, re.MULTILINE)


def build(advice: dict[str, Any]) -> Any:
    values = {"env_id": "DualJacoPush-v0", "per_arm_critics": True, "advice": advice}
    return build_model(RunConfig.from_mapping(values), SaverVecEnv("DualJacoPush-v0", n_envs=16))


@pytest.mark.parametrize(("name", "text"), ROWS, ids=[name for name, _ in ROWS])
def test_rows_build(name: str, text: str) -> None:
    advice = yaml.safe_load(text)
    model = build(advice)
    assert model.advisor.strategy.name == advice["strategy"]
    assert model.advisor.budget.total == advice["budget"]


def test_all_baselines_have_a_row() -> None:
    assert len(ROWS) == 6
    assert {"random", "jump-start", "ibrl"} <= {
        yaml.safe_load(text)["strategy"] for _, text in ROWS
    }


def test_all_strategies_are_on_the_page() -> None:
    for name in STRATEGIES:
        assert f"| `{name}` |" in PAGE
