"""Release a run's policy as weights: select it, evaluate it, and write it with a card."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from saver_advisors.evaluation.episodes import EpisodeOutcomes, evaluate_policy
from saver_advisors.evaluation.protocol import REPORT_SEED, SELECTION_SEED
from saver_advisors.evaluation.shield import Shield
from saver_advisors.policies.files import load_policy, save_policy
from saver_advisors.policies.freezing import networks_from_sb3
from saver_advisors.reporting.provenance import portable_command, portable_word
from saver_advisors.training.curve_file import read_curve
from saver_advisors.training.launch import load_trained
from saver_advisors.training.run_folder import read_record
from saver_advisors.training.settings import RunConfig
from saver_envs.files import read_json


def evaluate_trained(
    run_dir: str | Path,
    which: str,
    *,
    episodes: int,
    seed: int,
    threads: int = 1,
    shield: bool = False,
) -> EpisodeOutcomes:
    """Evaluate a run's student alone and without noise, without the easier starts of training.

    :param run_dir: the run's folder.
    :param which: ``best`` or ``latest``.
    :param episodes: number of episodes.
    :param seed: seed of the first; the others follow consecutively.
    :param threads: threads of the simulation.
    :param shield: whether to play with a :class:`saver_advisors.evaluation.shield.Shield`.
    :return: the outcome of each episode.
    """
    config = RunConfig.from_mapping(read_record(run_dir)["config"])
    options = {"threads": threads, "guard": Shield if shield else None}
    model = load_trained(run_dir, which)
    return _evaluated(model, config.env_id, config.env_kwargs, episodes, seed, **options)


def _evaluated(
    model: Any, env_id: str, env_kwargs: Mapping[str, Any], episodes: int, seed: int, **named: Any
) -> EpisodeOutcomes:
    """Evaluate the deterministic actions of a model or a frozen policy."""
    predict = partial(model.predict, deterministic=True)
    named |= {"episodes": episodes, "seed": seed, "env_kwargs": env_kwargs}
    return evaluate_policy(lambda observation: predict(observation)[0], env_id, **named)


def _rates(summary: Mapping[str, Any]) -> dict[str, Any]:
    """Return the figures of a card from the summary of an evaluation."""
    return {
        "success": summary["success_rate"],
        "success_episodes": summary["episodes"],
        "safe_success": summary["safe_success_rate"],
        "success_2cm": summary["success_rate_2cm"],
    }


def remeasure(weights: str | Path, path: str | Path, episodes: int | None = None) -> dict[str, Any]:
    """Measure the policy of a weight file again, and write it with the new figures on its card.

    :param weights: a weight file.
    :param path: the file to write, which may be the same.
    :param episodes: on the seeds from ``REPORT_SEED``; as many as on the card by default.
    :return: the summary of the evaluation.
    :raises ValueError: for a damaged file, or an environment that does not exist.
    """
    policy = load_policy(weights)
    card = policy.card
    n = card.success_episodes if episodes is None else episodes
    summary = _evaluated(policy, card.env_id, card.env_kwargs, n, REPORT_SEED).summary()
    save_policy(path, policy, replace(card, **_rates(summary)))
    return summary


def release_run(
    run_dir: str | Path, path: str | Path, *, task: str = "", episodes: int = 200
) -> dict[str, Any]:
    """Write the better of a run's best and latest policies as a weight file.

    The better has the higher ``RunConfig.score``. Selection and report use different episodes:
    those of ``SELECTION_SEED`` and ``REPORT_SEED``.

    :param run_dir: the run's folder.
    :param path: the file to write, ending in ``.safetensors``.
    :param task: the task in words, for the card.
    :param episodes: episodes per evaluation.
    :return: the scores of the selection, the choice, and the reported summary.
    """
    config = RunConfig.from_mapping(read_record(run_dir)["config"])
    played = partial(evaluate_trained, run_dir, episodes=episodes, seed=SELECTION_SEED)
    selection = {
        which: config.score(played(which).summary())
        for which in ("best", "latest")
        if (Path(run_dir) / which).exists()
    }
    chosen = max(selection, key=lambda which: selection[which])
    summary = evaluate_trained(run_dir, chosen, episodes=episodes, seed=REPORT_SEED).summary()
    record = read_record(run_dir)
    best = chosen == "best"
    settings = config.to_mapping()
    if config.start_from is not None:
        settings["start_from"] = portable_word(config.start_from)
    evaluation = Path(run_dir) / "best" / "evaluation.json"
    progress = read_json(evaluation) if best else read_curve(run_dir)[-1]
    card = {
        "env_id": config.env_id,
        "algorithm": config.algorithm,
        "command": portable_command(record["sessions"][0]["command"]),
        "steps": progress["steps"],
        "wall_clock_s": progress["wall_clock_s"],
        "seed": config.seed,
        "commit": record["sessions"][-1]["commit"] or "",
        **_rates(summary),
        "task": task,
        "env_kwargs": config.env_kwargs,
        "notes": {"config": settings, "selection": selection}
        | {name: summary[name] for name in ("randomization",) if name in summary},
    }
    save_policy(path, networks_from_sb3(load_trained(run_dir, chosen)), card)
    return {"selection": selection, "chosen": chosen, "summary": summary}
