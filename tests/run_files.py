"""Files of training runs with curves that were made up for a test, never measured."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

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


def write_run(
    folder: Path, task: str, row: str, seed: int, points: list[dict[str, Any]], **changes: Any
) -> Path:
    """Write a run's file; a change of None leaves the entry out."""
    content = {**run_content(task, row, seed, points), **changes}
    content = {name: value for name, value in content.items() if value is not None}
    path = folder / f"{task}-{row.replace(' ', '-')}-{seed}.json"
    path.write_text(json.dumps(content))
    return path
