"""Tiny runs under RL Zoo, in this process."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from saver_advisors.zoo import manager

ROOT = Path(__file__).resolve().parents[2]
CONFIGS = ROOT / "zoo_configs"
TINY = (
    "n_envs=2",
    "learning_starts=60",
    "train_freq=[10,step]",
    "gradient_steps=2",
    "batch_size=16",
    "buffer_size=1000",
    "policy_kwargs.net_arch=[8]",
)
"""Settings of a run that takes a second, with episodes of 10 steps."""
STARTING = (*TINY[:-1], "policy_kwargs.net_arch=[256,256,256]")
"""The same with networks that can start as two shipped teachers."""


def tiny(
    algorithm: str,
    env: str,
    output: Path,
    *more: object,
    steps: int = 160,
    settings: Sequence[str] = TINY,
) -> list[str]:
    """The words of `saver` for a tiny run; words after `--` go last."""
    rest = list(map(str, more))
    ours, theirs = (rest, []) if "--" not in rest else _split(rest)
    words = ["train", "--zoo", algorithm, "--env", env, "--output", str(output)]
    words += [
        "--steps",
        str(steps),
        "--env-kwargs",
        "max_episode_steps=10",
        *ours,
        "--set",
        *settings,
    ]
    return [*words, "--", "--eval-freq", "-1", "--log-interval", "1000", *theirs]


def _split(words: list[str]) -> tuple[list[str], list[str]]:
    at = words.index("--")
    return words[:at], words[at + 1 :]


@pytest.fixture
def models(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The models that runs under RL Zoo end with, as they are saved."""
    found: list[Any] = []
    save = manager.SaverExperimentManager.save_trained_model

    def keep(self: Any, model: Any) -> None:
        found.append(model)
        save(self, model)

    monkeypatch.setattr(manager.SaverExperimentManager, "save_trained_model", keep)
    return found
