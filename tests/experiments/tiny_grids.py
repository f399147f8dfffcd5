"""Grids of runs that take a second each."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from saver_advisors.experiments.grid import ExperimentRun, Grid

TINY_RUN: dict[str, Any] = {
    "total_steps": 160,
    "eval_every": 40,
    "eval_episodes": 2,
    "checkpoint_every": 40,
    "n_envs": 2,
    "net_arch": [8],
    "batch_size": 16,
    "gradient_steps": 2,
    "buffer_size": 400,
    "env_kwargs": {"max_episode_steps": 10},
}

GridFile = Callable[..., Path]


def tiny_grid(**settings: Any) -> dict[str, Any]:
    """The content of a grid file: two rows, three runs."""
    return {
        "title": "tiny",
        "final_episodes": 2,
        "groups": {
            "push": {
                "env_id": "DualJacoPush-v0",
                "settings": {**TINY_RUN, **settings},
                "advice": {"teacher": "jaco-push"},
                "budget_fraction": 0.25,
                "rows": {
                    "none": {},
                    "early": {"advice": {"strategy": "early"}, "seeds": [0, 1]},
                },
            }
        },
    }


def run_named(name: str, grid: Grid) -> ExperimentRun:
    """The run of a grid with that name."""
    return next(run for run in grid.runs if run.name == name)
