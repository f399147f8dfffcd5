"""The commands of docs/rl-zoo.md run, in the page's order, on tiny settings."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from zoo_runs import ROOT, STARTING, TINY

from saver_advisors.cli import main

TINY_HYPERPARAMETERS = (
    "n_envs:2",
    "learning_starts:60",
    "train_freq:[10,'step']",
    "gradient_steps:2",
    "batch_size:16",
    "buffer_size:1000",
    "policy_kwargs:{'net_arch':[8]}",
)
TINY_ROLLOUTS = ("n_envs=2", "n_steps=10", "batch_size=10", "policy_kwargs.net_arch=[8]")


def commands() -> list[str]:
    """The lines of the page's shell blocks."""
    text = (ROOT / "docs/rl-zoo.md").read_text()
    blocks = re.findall(r"^```bash\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)
    return [line for block in blocks for line in block.splitlines()]


def shortened(words: list[str]) -> list[str]:
    """The same command for some seconds."""
    if words[:2] == ["saver", "evaluate"]:
        return [*words, "--episodes", "2"]
    if words[:2] == ["saver", "train"]:
        ours, theirs = words, []
        if "--" in words:
            at = words.index("--")
            ours, theirs = words[:at], words[at + 1 :]
        # Students of this algorithm start as their teachers, whom small networks cannot hold.
        small = STARTING if "goal_td3" in words else TINY_ROLLOUTS if "ppo" in words else TINY
        tiny = ["--steps", "80", "--env-kwargs", "max_episode_steps=10", "--set", *small]
        return [*ours, *tiny, "--", "--eval-freq", "-1", *theirs]
    if "rl_zoo3.train" in words:
        tiny = ["-n", "80", "--env-kwargs", "max_episode_steps:10", "--eval-freq", "-1"]
        return [*words, *tiny, "--hyperparams", *TINY_HYPERPARAMETERS]
    return [*words, "-n", "20"]


@pytest.mark.slow
def test_every_command_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The settings files are found from a clone, the logs go where the reader is."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "zoo_configs").symlink_to(ROOT / "zoo_configs")
    found = commands()
    assert sum("rl_zoo3.train" in line for line in found) == 1
    assert sum("--zoo" in line for line in found) >= 4
    for line in found:
        words = shortened(shlex.split(line))
        if words[0] == "saver":
            assert main(words[1:]) == 0, line
        else:
            assert words[0] == "python"
            run = subprocess.run(
                [sys.executable, *words[1:]],
                capture_output=True,
                text=True,
                check=False,
                timeout=300,
            )
            assert run.returncode == 0, f"{line}\n{run.stderr}"
    assert (tmp_path / "logs/sac/JacoPush-v0_1/JacoPush-v0.zip").is_file()
    assert (tmp_path / "logs/advised_sac/DualJacoPush-v0_2/DualJacoPush-v0.zip").is_file()
