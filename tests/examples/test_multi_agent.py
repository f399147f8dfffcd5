"""The multi-agent baselines run, and their weights play together under `saver evaluate`."""

from __future__ import annotations

import json
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

from saver_advisors.cli.policies import resolve
from saver_advisors.reporting.errors import UsageError
from saver_envs.envs.sb3_vec_env import SaverVecEnv

EXAMPLE = Path(__file__).resolve().parents[2] / "docs" / "examples" / "multi_agent.py"


def trained(folder: Path, monkeypatch: pytest.MonkeyPatch, *words: str) -> str:
    """Run the example for two blocks, and return its policy as `saver evaluate` names it."""
    small = ["--steps", "100", "--every", "50", "--n-envs", "1"]
    small += ["--episodes", "1", "--gradient-steps", "2"]
    monkeypatch.setattr(sys, "argv", [EXAMPLE.name, "--output", str(folder), *small, *words])
    runpy.run_path(str(EXAMPLE), run_name="__main__")
    curve = json.loads((folder / "curve.json").read_text())
    assert [point["steps"] for point in curve] == [50, 100]
    files = sorted(str(path) for path in folder.glob("*.safetensors"))
    return "side-by-side:" + ",".join(files)


@pytest.mark.slow
def test_shared_parameters_are_one_policy_of_all_arms(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Its goals share the distance, which every agent sees.
    env_id = "DualJacoDistance-v0"
    predict = resolve(trained(tmp_path, monkeypatch, "--env", env_id), env_id, {})
    seen = SaverVecEnv(env_id, 2, seed=0).reset()
    actions = predict(seen)
    assert actions.shape == (2, 8)
    changed = {key: rows.copy() for key, rows in seen.items()}
    changed["observation"][:, :28] = seen["observation"][:, 28:]
    changed["desired_goal"][:, :3] = seen["desired_goal"][:, 3:6]
    np.testing.assert_array_equal(predict(changed)[:, :4], actions[:, 4:])
    changed["desired_goal"][:, 6] += 0.5
    assert (predict(changed) != predict(seen)).all(axis=1).all()


@pytest.mark.slow
def test_independent_learners_have_a_policy_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    env_id = "DualJacoPush-v0"
    policy = trained(tmp_path, monkeypatch, "--independent")
    predict = resolve(policy, env_id, {})
    seen = SaverVecEnv(env_id, 2, seed=0).reset()
    seen["observation"][:, :28] = seen["observation"][:, 28:]
    seen["desired_goal"][:, :3] = seen["desired_goal"][:, 3:]
    left, right = np.split(predict(seen), 2, axis=1)
    assert (left != right).all()
    with pytest.raises(UsageError, match="2 teachers for 3 arms"):
        resolve(policy, env_id, {"n_arms": 3})
