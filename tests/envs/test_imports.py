"""What an import costs, and that an id brings its package along."""

from __future__ import annotations

import subprocess
import sys

import pytest


def python(code: str) -> str:
    """Run code in a fresh interpreter and return what it prints."""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_importing_the_environments_pulls_in_no_learning_library() -> None:
    heavy = ("torch", "stable_baselines3", "sb3_contrib", "matplotlib", "pandas")
    check = f"import sys; print([name for name in {heavy!r} if name in sys.modules])"
    assert python(f"import saver_envs; {check}") == "[]"
    made = "import gymnasium, saver_envs; gymnasium.make('JacoPush-v0').reset(seed=0)"
    assert python(f"{made}; {check}") == "[]"


@pytest.mark.parametrize(
    "code",
    [
        "import gymnasium; print(gymnasium.make('saver_envs:JacoPush-v0').reset(seed=0)[1])",
        "import gymnasium; e = gymnasium.make_vec('saver_envs:DualJacoPush-v0', num_envs=8);"
        " print(type(e).__name__, e.reset(seed=0)[1]['is_success'])",
    ],
)
def test_ids_bring_their_package(code: str) -> None:
    assert "is_success" in python(code) or "SaverVectorEnv" in python(code)


def test_pettingzoos_registry() -> None:
    code = "import saver_envs, pettingzoo; e = pettingzoo.make('parallel', '{}'); print(e)"
    assert python(code.format("saver_envs/DualJacoPush-v0")) == "DualJacoPush-v0"
