"""The built wheel in an empty environment: assets and weights inside, no torch needed."""

from __future__ import annotations

import subprocess
import zipfile
from pathlib import Path

import pytest

STEPS_AN_ID = """
import sys
import gymnasium
import saver_envs
env = gymnasium.make("DualJacoPush-v0")
env.reset(seed=0)
observation, *_, info = env.step(env.action_space.sample())
assert observation["observation"].shape == (56,), observation["observation"].shape
assert "cost" in info
assert saver_envs.__file__.startswith(sys.prefix), saver_envs.__file__
loaded = {"torch", "stable_baselines3"} & set(sys.modules)
assert not loaded, loaded
print("stepped")
"""


@pytest.mark.slow
def test_assets_weights_and_settings_are_inside(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    assert "saver_envs/robots/assets/jaco/wrist.stl" in names
    assert "saver_advisors/saver.yml" in names
    for name in ("jaco-push", "jaco-pick-and-place", "dual-jaco-push"):
        assert f"saver_advisors/pretrained/weights/{name}.safetensors" in names
    assert {"saver_envs/py.typed", "saver_advisors/py.typed"} <= names
    assert not [name for name in names if name.startswith("tests/")]


@pytest.mark.slow
def test_an_id_is_made_and_stepped_without_torch(base_programs: Path, tmp_path: Path) -> None:
    python = base_programs / "python"
    # From elsewhere, and without the variables that could point back to this checkout.
    completed = subprocess.run(
        [str(python), "-I", "-c", STEPS_AN_ID],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert completed.returncode == 0, completed.stderr
    assert "stepped" in completed.stdout
    absent = subprocess.run([str(python), "-I", "-c", "import torch"], capture_output=True)
    assert absent.returncode != 0
