"""Demonstrations survive the process that recorded them."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hasty_operator import __file__ as OPERATOR

pytest.importorskip("viser")
minari = pytest.importorskip("minari")

from saver_advisors.training.run_folder import locked  # noqa: E402
from saver_envs.envs.goal_env import SaverGoalEnv  # noqa: E402

NAME = "saver/by-hand-v0"
PATIENCE = 300.0
"""Seconds until demonstrations that do not come are given up."""


def command(sets: Path, *more: object) -> list[str]:
    words = ["view", "--env", "JacoPush-v0", "--control", "keyboard", "--keep-failures"]
    words += ["--record", NAME, "--output", str(sets), "--speed", "50"]
    words += ["--env-kwargs", "max_episode_steps=4"]
    return [sys.executable, str(OPERATOR), *words, *map(str, more)]


@pytest.mark.slow
def test_a_killed_process_loses_no_demonstration(tmp_path: Path) -> None:
    kept = tmp_path / "saver" / "by-hand-v0.unfinished"
    with subprocess.Popen(command(tmp_path, "--seed", 5)) as process:
        try:
            end = time.monotonic() + PATIENCE
            while len(list(kept.glob("*.npz"))) < 3:
                assert process.poll() is None, "it ended by itself"
                assert time.monotonic() < end
                time.sleep(0.05)
        finally:
            process.send_signal(signal.SIGKILL)
    assert process.returncode == -signal.SIGKILL
    survivors = len(list(kept.glob("*.npz")))
    assert survivors >= 3
    assert not (tmp_path / NAME).exists()

    longer = command(tmp_path, "--env-kwargs", "max_episode_steps=5")
    other = subprocess.run(longer, capture_output=True, text=True, check=False)
    assert other.returncode == 2
    assert "has episodes of" in other.stderr

    count = survivors + 2
    done = subprocess.run(
        command(tmp_path, "--episodes", count), capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert f"going on with {survivors} demonstrations" in done.stderr
    assert f"wrote {count} demonstrations" in done.stdout
    assert not kept.exists()
    dataset = minari.MinariDataset(tmp_path / NAME / "data")
    seeds = [int(one["seed"]) for one in dataset.storage.get_episode_metadata(range(count))]
    assert seeds == list(range(5, 5 + count))
    env = SaverGoalEnv("JacoPush-v0", max_episode_steps=4)
    for seed, episode in zip(seeds, dataset.iterate_episodes(), strict=True):
        env.reset(seed=seed)
        for step, action in enumerate(episode.actions):
            seen, *_ = env.step(action)
            np.testing.assert_array_equal(
                seen["observation"], episode.observations["observation"][step + 1]
            )
    env.close()


@pytest.mark.slow
def test_two_processes_do_not_mix(tmp_path: Path) -> None:
    kept = tmp_path / "saver" / "by-hand-v0.unfinished"
    with locked(kept):
        second = subprocess.run(command(tmp_path), capture_output=True, text=True, check=False)
    assert second.returncode == 2
    assert "is in use by process" in second.stderr
    assert kept.exists()
