"""A task in a file of its own works wherever ours do, without a line of ours being changed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pettingzoo
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test
from rollouts import assert_same, begun, random_actions

from saver_envs.envs.sb3_vec_env import SaverVecEnv
from saver_envs.experts import make_expert

EXAMPLES = Path(__file__).resolve().parents[2] / "docs" / "examples"
ENV_ID = "own_task:DualJacoBeam-v0"


def saver(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run the command line from another folder, as a user of the wheel does."""
    environment = {**os.environ, "PYTHONPATH": f"{EXAMPLES}{os.pathsep}{EXAMPLES.parents[1]}"}
    return subprocess.run(
        [sys.executable, "-m", "saver_advisors.cli", *words],
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


def test_it_is_as_short_as_promised() -> None:
    assert len((EXAMPLES / "own_task.py").read_text().splitlines()) <= 120


def test_checkers_and_adapters() -> None:
    env = gymnasium.make(ENV_ID)
    check_env(env.unwrapped, skip_render_check=True)
    vector = gymnasium.make_vec(ENV_ID, num_envs=3)
    observation, _ = vector.reset(seed=0)
    single, _ = env.reset(seed=1)
    assert_same({key: rows[1] for key, rows in observation.items()}, single)
    parallel_api_test(pettingzoo.make("parallel", "saver_envs/DualJacoBeam-v0"), num_cycles=60)
    agents = pettingzoo.make("parallel", "saver_envs/DualJacoBeam-v0")
    assert agents.observation_space("arm_0").shape == (12 + 12 + 2 * 6,)
    batch = SaverVecEnv(ENV_ID, n_envs=2, seed=0).reset()
    assert batch["observation"].shape == (2, 2 * 12 + 12)


def test_rewards_can_be_relabelled() -> None:
    env = gymnasium.make(ENV_ID).unwrapped
    env.reset(seed=0)
    seen, reward, *_ = env.step(env.action_space.sample())
    assert reward == env.compute_reward(seen["achieved_goal"], seen["desired_goal"], {}) == -1
    assert env.compute_reward(seen["achieved_goal"], seen["achieved_goal"], {}) == 0
    dense = gymnasium.make(ENV_ID.replace("-v0", "Dense-v0")).unwrapped
    goals = seen["achieved_goal"], seen["desired_goal"]
    gaps = np.linalg.norm((goals[0] - goals[1]).reshape(2, 3), axis=-1)
    assert dense.compute_reward(*goals, {}) == pytest.approx(-gaps.sum(), abs=1e-6)


def test_the_expert_needs_both_arms() -> None:
    expert = make_expert(ENV_ID)
    rates = {}
    for free in (None, 0):
        episodes = begun(ENV_ID, 20, seed=500)
        for _ in range(50):
            actions = expert.predict(episodes.observation().as_dict())[0]
            if free is not None:
                actions[:, 3:] = 0
            outcome = episodes.step(actions)
        rates[free] = outcome.success.mean()
    assert rates[None] >= 0.95
    assert rates[0] <= 0.05


def test_its_beam_is_lost_beyond_the_table_without_a_line_of_its_own() -> None:
    episodes = begun(ENV_ID, 2)
    episodes.simulation.qpos[1, episodes.scene.loose_qpos[0, 0]] = 1.0
    assert episodes.step(np.zeros((2, 6))).lost.tolist() == [False, True]


def test_states_are_copied_and_pickled() -> None:
    episodes = begun(ENV_ID, 2)
    state = episodes.get_state()
    ahead = [vars(episodes.step(action)) for action in random_actions(6, 5, 2)]
    episodes.set_state(state)
    assert_same([vars(episodes.step(action)) for action in random_actions(6, 5, 2)], ahead)


@pytest.mark.slow
def test_every_command_takes_it(tmp_path: Path) -> None:
    words = ["evaluate", "--env", ENV_ID, "--episodes", "4", "--json", "result.json"]
    done = saver(*words, "--policy", "expert", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    result = json.loads((tmp_path / "result.json").read_text())
    assert result["success_rate"] == 1.0
    assert len(result["final_distance_mean"]) == 2
    small = ["--set", "net_arch=[8]", "batch_size=16", "gradient_steps=2", "eval_episodes=2"]
    steps = ["--steps", "200", "--no-progress", "--output", "run"]
    done = saver("train", "--env", ENV_ID, *steps, *small, "n_envs=2", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    done = saver("evaluate", "--env", ENV_ID, "--policy", "run", "--episodes", "2", cwd=tmp_path)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_a_grid_takes_it(tmp_path: Path) -> None:
    (tmp_path / "grid.yml").write_text(
        f"title: beam\ngroups:\n  beam:\n    env_id: {ENV_ID}\n    seeds: [0]\n    settings:\n"
        "      {total_steps: 100, net_arch: [8], batch_size: 16, gradient_steps: 2, n_envs: 2,\n"
        "      eval_every: 100, eval_episodes: 2, checkpoint_every: 100}\n"
        "    rows:\n      none: {}\n"
    )
    done = saver("experiments", "run", "grid.yml", "--output", "runs", cwd=tmp_path)
    assert done.returncode == 0, done.stderr + done.stdout
