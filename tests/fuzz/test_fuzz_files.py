"""Weights, settings, grids, curves and results: read whole, or refused with the file's name."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fuzzing import ODD, cases, damaged, refusal
from hypothesis import given
from hypothesis import strategies as st

from saver_advisors.experiments.grid import read_grid
from saver_advisors.experiments.results import read_result
from saver_advisors.experiments.search import read_search
from saver_advisors.policies.files import load_policy
from saver_advisors.policies.stored_models import networks_of_zip
from saver_advisors.training.checkpoint import read_state
from saver_advisors.training.curve_file import CURVE_FILE, read_curve
from saver_advisors.training.settings import RunConfig
from saver_envs.modelling.models import load_model
from saver_envs.perception.weights import load_network

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("files")


def read(folder: Path, name: str, content: bytes, reader: Callable[[Path], Any]) -> Any:
    """Write a file, read it; returns None where it is refused, which must be by its name."""
    path = folder / name
    path.write_bytes(content)
    found, message = refusal("files", lambda: reader(path), ValueError, OSError)
    assert found is not None or name in message, message
    return found


POLICY = (ROOT / "saver_advisors/pretrained/weights/jaco-push.safetensors").read_bytes()
MODEL = (ROOT / "saver_envs/modelling/weights/jaco-ik.safetensors").read_bytes()


@cases(2.0)
@given(content=damaged(POLICY))
def test_policies(folder: Path, content: bytes) -> None:
    if content != POLICY:
        assert read(folder, "policy.safetensors", content, load_policy) is None


@cases(2.0)
@given(content=damaged(MODEL))
def test_inverse_models(folder: Path, content: bytes) -> None:
    if content != MODEL:
        assert read(folder, "model.safetensors", content, load_model) is None


@cases()
@given(content=st.one_of(damaged(POLICY), damaged(MODEL)))
def test_pose_networks(folder: Path, content: bytes) -> None:
    assert read(folder, "pose.safetensors", content, load_network) is None


CURVE = "".join(
    json.dumps({"steps": 100 * row, "success_rate": row / 5, "wall_clock_s": 1.5 * row}) + "\n"
    for row in range(1, 5)
).encode()


@cases(2.0)
@given(content=damaged(CURVE))
def test_curves(folder: Path, content: bytes) -> None:
    points = read(folder, CURVE_FILE, content, lambda path: read_curve(path.parent))
    for point in points or ():
        assert {"steps", "success_rate", "wall_clock_s"} <= set(point)


GRID = b"""\
title: tiny
final_episodes: 2
groups:
  push:
    env_id: DualJacoPush-v0
    settings: {total_steps: 160, net_arch: [8]}
    advice: {teacher: jaco-push}
    budget_fraction: 0.25
    rows:
      none: {}
      early: {advice: {strategy: early}, seeds: [0, 1]}
"""


@cases(2.0)
@given(content=damaged(GRID))
def test_grids(folder: Path, content: bytes) -> None:
    grid = read(folder, "grid.yml", content, read_grid)
    assert grid is None or grid.runs


SEARCH = b"""\
title: tiny
env_id: JacoPush-v0
settings: {total_steps: 160, net_arch: [8]}
space:
  learning_rate: {log_uniform: [1.0e-4, 3.0e-3]}
  gradient_steps: {int: [1, 9]}
  train_env_kwargs.rated: {choice: [true, false]}
seeds: [0, 1]
objective: {mean_success: 3}
trials: 2
pruner: {startup_trials: 1, warmup_steps: 40}
"""


@cases(2.0)
@given(content=damaged(SEARCH))
def test_searches(folder: Path, content: bytes) -> None:
    search = read(folder, "search.yml", content, read_search)
    assert search is None or (search.trials and search.space)


RUN: dict[str, Any] = RunConfig("DualJacoPush-v0").to_mapping()


@cases(3.0)
@given(st.dictionaries(st.sampled_from([*RUN, "more"]), ODD, min_size=1, max_size=3))
def test_run_settings(changes: dict[str, Any]) -> None:
    config, message = refusal(
        "files", lambda: RunConfig.from_mapping({**RUN, **changes}), ValueError, TypeError
    )
    if config is None:
        assert any(name in message for name in changes), message


@cases()
@given(
    content=damaged(
        json.dumps({"steps": 1, "updates": 1, "episodes": 1, "random": {}, "extra": {}}).encode()
    )
)
def test_checkpoints(folder: Path, content: bytes) -> None:
    state = read(folder, "state.json", content, lambda path: read_state(path.parent))
    assert state is None or isinstance(state["extra"], dict)


@cases()
@given(content=damaged(json.dumps({"kind": "saver-run", "config": RUN}).encode()))
def test_results(folder: Path, content: bytes) -> None:
    assert read(folder, "result.json", content, read_result) is None


@cases()
@given(content=damaged(b"PK\x03\x04" + bytes(60)))
def test_stored_models(folder: Path, content: bytes) -> None:
    assert read(folder, "model.zip", content, networks_of_zip) is None
