"""Recorded settings get their new names; what was recorded about a run's origin stays."""

from __future__ import annotations

import json
import runpy
import shutil
from pathlib import Path
from typing import Any

import pytest
import torch as th
import yaml
from safetensors import safe_open
from safetensors.torch import load_file

from saver_advisors.pretrained import load_policy
from saver_advisors.training.settings import RunConfig

ROOT = Path(__file__).resolve().parents[2]
WEIGHTS = ROOT / "saver_advisors" / "pretrained" / "weights"
TOOL: dict[str, Any] = runpy.run_path(str(ROOT / "tools" / "rename_settings.py"))


def with_old_names(value: Any) -> Any:
    old = {new: name for name, new in TOOL["NEW_NAMES"].items()}
    if isinstance(value, dict):
        return {old.get(name, name): with_old_names(one) for name, one in value.items()}
    return value


def test_settings_of_a_run_are_renamed_and_its_origin_is_not(tmp_path: Path) -> None:
    config = RunConfig.from_mapping(
        {
            "env_id": "JacoPickAndPlace-v0",
            "train_env_kwargs": {"in_hand_probability": 0.4},
            "per_arm_critics": True,
            "advice": {"strategy": "none", "teacher": "a", "budget": 0, "warm_start": True},
        }
    )
    origin = {"command": "saver train --set arms_apart=true", "sessions": [{"arms_apart": 1}]}
    old = {"config": with_old_names(config.to_mapping()), **origin}
    assert old["config"]["arms_apart"] and old["config"]["advice"]["start_as_teacher"]
    record, settings = tmp_path / "runs" / "run.json", tmp_path / "mine.yml"
    record.parent.mkdir()
    record.write_text(json.dumps(old))
    settings.write_text("# arms_apart: see the docs\na: {start_as_teacher: true, arms_apart: 1}\n")
    TOOL["main"]([str(tmp_path)])
    renamed = json.loads(record.read_text())
    assert RunConfig.from_mapping(renamed["config"]) == config
    assert {name: renamed[name] for name in origin} == origin
    assert yaml.safe_load(settings.read_text()) == {"a": {"warm_start": True, "per_arm_critics": 1}}
    before = [path.read_bytes() for path in (record, settings)]
    TOOL["main"]([str(tmp_path)])
    assert [path.read_bytes() for path in (record, settings)] == before


def test_the_card_of_a_weight_file_is_renamed_and_its_tensors_are_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from safetensors.torch import save_file

    shipped, path = WEIGHTS / "dual-jaco-push.safetensors", tmp_path / "dual-jaco-push.safetensors"
    tensors = load_file(shipped)
    with safe_open(shipped, framework="pt") as file:
        metadata = dict(file.metadata())
    card = with_old_names(json.loads(metadata["card"]))
    assert card["notes"]["config"]["arms_apart"]
    save_file(tensors, path, {**metadata, "card": json.dumps(card)})
    TOOL["main"]([str(tmp_path)])
    assert capsys.readouterr().out == f"{path}\n"
    assert load_policy(path).card == load_policy(shipped).card
    for name, tensor in load_file(path).items():
        assert th.equal(tensor, tensors[name]), name
    assert path.with_suffix(".md").read_text() == shipped.with_suffix(".md").read_text()
    once = path.read_bytes()
    TOOL["main"]([str(path)])
    assert path.read_bytes() == once


def test_committed_files_have_the_new_names(tmp_path: Path) -> None:
    for folder in ("zoo_configs", "docs/results", "saver_advisors/pretrained/weights"):
        shutil.copytree(ROOT / folder, tmp_path / folder)
    changed = [path for path in TOOL["files"]([tmp_path]) if TOOL["RENAMES"][path.suffix](path)]
    assert not changed
