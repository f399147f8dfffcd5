"""Each shipped weight file has a card that says what it is, what it is for, and on what terms."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from saver_advisors.cli.model import MODEL_CARD
from saver_advisors.policies.cards import card_markdown
from saver_advisors.policies.files import read_networks
from saver_advisors.reporting.templates import rendered
from saver_envs.modelling.models import read_card

ROOT = Path(__file__).resolve().parents[2]
POLICIES = sorted((ROOT / "saver_advisors" / "pretrained" / "weights").glob("*.safetensors"))
MODELS = sorted((ROOT / "saver_envs" / "modelling" / "weights").glob("*.safetensors"))


@pytest.mark.parametrize("path", POLICIES, ids=lambda path: path.stem)
def test_cards_of_policies_are_those_of_the_files(path: Path) -> None:
    text = path.with_suffix(".md").read_text()
    assert text == card_markdown(path.stem, read_networks(path)[1])


@pytest.mark.parametrize("path", MODELS, ids=lambda path: path.stem)
def test_cards_of_models_are_those_of_the_files(path: Path) -> None:
    text = rendered("saver_advisors.cli", MODEL_CARD, stem=path.stem, card=read_card(path))
    assert path.with_suffix(".md").read_text() == text


@pytest.mark.parametrize("path", [*POLICIES, *MODELS], ids=lambda path: path.stem)
def test_a_card_states_task_data_use_limits_and_licence(path: Path) -> None:
    text = path.with_suffix(".md").read_text()
    for part in ("| task |", "Intended use:", "Training data:", "Limits:", "Licence:"):
        assert part in text
    assert re.search(r"\| (success|validation RMSE) \| [\d.]+", text)
