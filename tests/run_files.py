"""Files of training runs with curves that were made up for a test, never measured."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from saver_advisors.evaluation.protocol import REPORT_EPISODES, REPORT_SEED, SELECTION_SEED
from saver_advisors.evaluation.statistics import success_interval
from saver_envs.digest import world_digest

EVERY = 25_000


def curve(
    middle: float, best: float = 1.0, evaluations: int = 40, width: float = 3.0
) -> list[dict[str, Any]]:
    """Success that rises smoothly to ``best``, half of it at evaluation ``middle``."""
    lines = []
    for k in range(1, evaluations + 1):
        success = round(best / (1 + math.exp((middle - k) / width)), 2)
        lines.append(
            {
                "steps": EVERY * k,
                "wall_clock_s": 60.0 * k,
                "success_rate": success,
                "mean_q": 20 * success - 25,
                "cost_collision": 2.5,
                "advice_spent": min(EVERY * k, 100_000),
            }
        )
    return lines


def run_content(task: str, row: str, seed: int, points: list[dict[str, Any]]) -> dict[str, Any]:
    """A finished run with everything that the experiment runner writes."""
    return {
        "kind": "training-run",
        "name": f"{row}-{seed}",
        "task": task,
        "row": row,
        "seed": seed,
        "config": {"env_id": task, "total_steps": points[-1]["steps"], "eval_episodes": 100},
        "curve": points,
        "final": {"success_rate": points[-1]["success_rate"], "ci95": [0.9, 1.0], "episodes": 500},
        "teacher_steps": 0 if row == "none" else 600_000,
        "demonstration_steps": 0,
        "finished": True,
        "sessions": [],
        "provenance": {"commit": "0123456789abcdef", "machine": {"cpu": "X", "cores": 2}},
    }


def valid_content(task: str, row: str, seed: int, success: float = 0.9) -> dict[str, Any]:
    """A run by the protocol: half a million steps, and everything that a submission needs."""
    content = run_content(task, row, seed, curve(8, best=success, evaluations=20))
    world = world_digest(task)
    final = {
        "env": task,
        "world": world,
        "seed": REPORT_SEED,
        "episodes": REPORT_EPISODES,
        "success_rate": success,
        "safe_success_rate": success - 0.1,
        "success_rate_2cm": success - 0.2,
        "ci95": list(success_interval(round(success * REPORT_EPISODES), REPORT_EPISODES)),
        "cost_means": {"cost_collision": 0.5},
    }
    rules = {"eval_every": EVERY, "eval_seed": SELECTION_SEED, "seed": seed, "n_envs": 16}
    config = {**content["config"], "env_kwargs": {}, "algorithm": "mine.py:Mine", **rules}
    names = ("python", "mujoco", "gymnasium", "numpy")
    provenance = {**content["provenance"], "versions": dict.fromkeys(names, "1")}
    more = {"teacher_steps": 0, "world": world, "final": final, "config": config}
    return {**content, **more, "provenance": provenance}


def write_run(
    folder: Path, task: str, row: str, seed: int, points: list[dict[str, Any]], **changes: Any
) -> Path:
    """Write a run's file; a change of None leaves the entry out."""
    content = {**run_content(task, row, seed, points), **changes}
    content = {name: value for name, value in content.items() if value is not None}
    path = folder / f"{task}-{row.replace(' ', '-')}-{seed}.json"
    path.write_text(json.dumps(content))
    return path
