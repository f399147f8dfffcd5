"""Rule 2: a task in a file of its own works with the modules of our tasks taken away."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
#: Puts empty classes in place of our tasks, then plays the own task in every adapter.
PROGRAM = """
import sys
from types import ModuleType

for module, name in (
    ("push", "Push"),
    ("pick_and_place", "PickAndPlace"),
    ("distance", "Distance"),
    ("arm_straighten", "ArmStraighten"),
    ("carry", "Carry"),
    ("intake", "Intake"),
    ("leg_straighten", "LegStraighten"),
    ("log_roll", "LogRoll"),
    ("wrist_push", "WristPush"),
):
    stub = ModuleType(f"saver_envs.tasks.{module}")
    setattr(stub, name, type(name, (), {"horizon": 50}))
    sys.modules[stub.__name__] = stub

import gymnasium
import numpy as np
import saver_envs
from pettingzoo.test import parallel_api_test
from saver_advisors.evaluation.episodes import evaluate_policy
from saver_envs.envs.parallel_env import parallel_env
from saver_envs.envs.sb3_vec_env import SaverVecEnv
from saver_envs.experts import make_expert

ID = "own_task:DualJacoBeam-v0"
env = gymnasium.make(ID, render_mode=None)
env.reset(seed=0)
env.step(env.action_space.sample())
vector = gymnasium.make_vec(ID, num_envs=2)
vector.reset(seed=0)
vector.step(vector.action_space.sample())
parallel_api_test(parallel_env(ID), num_cycles=20)
expert = make_expert(ID)
outcomes = evaluate_policy(lambda seen: expert.predict(seen)[0], ID, episodes=4)
assert outcomes.success_rate == 1.0, outcomes
kept = [name for name in sys.modules if name.startswith("saver_envs.tasks.")]
print("played", sorted(kept))
"""


def test_the_own_task_needs_none_of_ours() -> None:
    paths = os.pathsep.join([str(ROOT / "docs" / "examples"), str(ROOT)])
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": paths},
    )
    assert done.returncode == 0, done.stderr
    assert "played" in done.stdout
    for absent in ("cubes", "table", "board", "care", "wrist_starts", "regions"):
        assert f"saver_envs.tasks.{absent}'" not in done.stdout, done.stdout
