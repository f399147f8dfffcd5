"""What tests of the command line share: a command's result, and the words of tiny runs."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[2]
TINY = (
    "net_arch=[8]",
    "batch_size=16",
    "gradient_steps=2",
    "n_envs=2",
    "buffer_size=400",
    "eval_every=20",
    "eval_episodes=2",
    "checkpoint_every=20",
)
"""Settings of a run that takes a second."""


class Result(NamedTuple):
    """What a command left behind."""

    status: int
    out: str
    err: str


Saver = Callable[..., Result]


def tiny_train(output: Path, *more: object) -> list[object]:
    """The words of a tiny training run: 40 steps of episodes of 10."""
    return [
        *("train", "--env", "JacoPush-v0", "--output", output, "--steps", 40, "--no-progress"),
        *("--env-kwargs", "max_episode_steps=10", "--set", *TINY, *more),
    ]


def read_json(path: Path) -> dict[str, Any]:
    """A file that a command wrote."""
    content: dict[str, Any] = json.loads(path.read_text())
    return content
