"""From a run's folder to weights that ship: pick, evaluate, write with a card."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from saver_advisors.evaluation.episodes import EpisodeOutcomes, evaluate_policy
from saver_advisors.evaluation.protocol import REPORT_SEED, SELECTION_SEED
from saver_advisors.policies.files import export_policy
from saver_advisors.reporting.provenance import portable_command
from saver_advisors.training.curve_file import read_curve
from saver_advisors.training.launch import load_trained
from saver_advisors.training.settings import RunConfig


def evaluate_trained(
    run_dir: str | Path, which: str, *, episodes: int, seed: int, threads: int = 1
) -> EpisodeOutcomes:
    """Evaluate a run's student alone, deterministic, on its own task without training's helps.

    :param run_dir: the run's folder
    :param which: ``best`` or ``latest``
    :param episodes: how many
    :param seed: of the first, the others count up
    :param threads: of the simulation
    :return: what happened
    """
    config = _config(run_dir)
    model = load_trained(run_dir, which)

    def predict(observation: dict[str, Any]) -> Any:
        return model.predict(observation, deterministic=True)[0]

    return evaluate_policy(
        predict,
        config.env_id,
        episodes=episodes,
        seed=seed,
        env_kwargs=config.env_kwargs,
        threads=threads,
    )


def release_run(
    run_dir: str | Path, path: str | Path, *, task: str = "", episodes: int = 200
) -> dict[str, Any]:
    """Write the better of a run's best and latest policies as shipped weights.

    The choice is made on seeds from 10,000 up; the card's success is measured on seeds from 0.

    :param run_dir: the run's folder
    :param path: where to, ending in ``.safetensors``
    :param task: the task in words, for the card
    :param episodes: of each evaluation
    :return: the selection's success rates, the choice, and the reported summary
    """
    selection = {
        which: evaluate_trained(run_dir, which, episodes=episodes, seed=SELECTION_SEED).success_rate
        for which in ("best", "latest")
        if (Path(run_dir) / which).exists()
    }
    chosen = max(selection, key=lambda which: selection[which])
    summary = evaluate_trained(run_dir, chosen, episodes=episodes, seed=REPORT_SEED).summary()
    record = _record(run_dir)
    progress = _progress(run_dir, chosen)
    config = _config(run_dir)
    card = {
        "env_id": config.env_id,
        "algorithm": config.algorithm,
        "command": portable_command(record["sessions"][0]["command"]),
        "steps": progress["steps"],
        "wall_clock_s": progress["wall_clock_s"],
        "seed": config.seed,
        "commit": record["sessions"][-1]["commit"] or "",
        "success": summary["success_rate"],
        "success_episodes": episodes,
        "task": task,
        "env_kwargs": config.env_kwargs,
        "notes": {"config": config.to_mapping(), "selection": selection},
    }
    export_policy(load_trained(run_dir, chosen), path, card)
    return {"selection": selection, "chosen": chosen, "summary": summary}


def _record(run_dir: str | Path) -> dict[str, Any]:
    record: dict[str, Any] = json.loads((Path(run_dir) / "run.json").read_text(encoding="utf-8"))
    return record


def _config(run_dir: str | Path) -> RunConfig:
    return RunConfig.from_mapping(_record(run_dir)["config"])


def _progress(run_dir: str | Path, which: str) -> dict[str, Any]:
    """Steps and seconds at which the chosen policy was taken."""
    if which == "best":
        path = Path(run_dir) / "best" / "evaluation.json"
        best: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        return best
    return read_curve(run_dir)[-1]
