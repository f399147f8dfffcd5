"""Run Jaco policies on two MICOs with other objects and sensors, and compare with Table 5.4.

Each policy runs unchanged on the dual MICO scenes: first on the plain scenes, then with one
difference at a time, then with all of them. A failed trial has one cause, derived from its
trajectory.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from reproduction.command_parts import measure_and_render
from reproduction.transfer.attempts import EXPERT, TITLES, Attempt, Condition, Played, conditions
from reproduction.transfer.failures import find_failure
from reproduction.transfer.transfer_page import render
from saver_advisors.cli.arguments import add_count, add_page
from saver_advisors.cli.policies import resolve
from saver_advisors.evaluation.statistics import success_interval
from saver_advisors.reporting.errors import UsageError, unknown
from saver_advisors.reporting.figures import link

EXAMPLES: Final = """\
examples:
  python -m reproduction transfer --json transfer.json --table transfer.md --video-dir videos
  python -m reproduction transfer --pick --push advised=dual-jaco-push-advised
  python -m reproduction transfer --conditions mico all --trials 10
  python -m reproduction transfer --from transfer.json --table transfer.md

policies:
  [LABEL=]POLICY, with a POLICY as in `saver evaluate`: a shipped name, a weight file, a run's
  folder, side-by-side:TEACHER, expert. The labels advised and scratch match the paper's rows."""

STUDENTS: Final = {
    "push": "dual-jaco-push-advised",
    "pick": "dual-jaco-pick-and-place-advised",
}
TEACHERS: Final = {"push": "jaco-push", "pick": "jaco-pick-and-place"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    for task, title in TITLES.items():
        parser.add_argument(
            f"--{task}",
            nargs="*",
            metavar="[LABEL=]POLICY",
            help=f"policies for {title.lower()}; without any the task is left out (default: the "
            "advised student if it ships, teachers side by side, the scripted expert)",
        )
    parser.add_argument("--conditions", nargs="+", metavar="NAME", help="conditions (default: all)")
    add_count(parser, "--trials", 50, "trials of each policy under each condition")
    add_count(parser, "--seed", 0, "seed of trial 0", least=0)
    parser.add_argument(
        "--video-dir",
        type=Path,
        metavar="DIR",
        help="folder for videos of a success and of each cause of failure, as MP4 and as WebP",
    )
    add_page(parser)


def run(args: argparse.Namespace) -> int:
    """Measure, print the page, and write the requested files.

    :param args: see :func:`add_arguments`.
    :return: exit status.
    :raises UsageError: for an unknown condition or policy.
    """
    clips = None
    if args.video_dir is not None:
        clips = link(args.video_dir, Path.cwd() if args.table is None else args.table.parent)
    return measure_and_render(
        args, "transfer", lambda: measure(args), lambda figures: render(figures, clips)
    )


def entrants(task: str, words: Sequence[str] | None) -> dict[str, str]:
    """List the policies that try a task.

    :param task: ``push`` or ``pick``.
    :param words: ``[LABEL=]POLICY`` each; the default policies if None.
    :return: policies by label.
    :raises UsageError: for two policies with the same label.
    """
    from saver_advisors.pretrained import shipped_policies

    if words is None:
        student = STUDENTS[task]
        return {
            **({"advised": student} if student in shipped_policies() else {}),
            "teachers side by side": f"side-by-side:{TEACHERS[task]}",
            "scripted expert": EXPERT,
        }
    pairs = [word.partition("=")[::2] if "=" in word else (word, word) for word in words]
    found = dict(pairs)
    if len(found) < len(pairs):
        labels = [label for label, _ in pairs]
        raise UsageError(f"argument --{task}: {labels} must have different labels")
    return found


def _conditions(names: Sequence[str] | None) -> dict[str, list[Condition]]:
    """Return the conditions of each task, or those of these names."""
    every = {task: list(conditions(task)) for task in TITLES}
    known = list(dict.fromkeys(one.name for several in every.values() for one in several))
    if names is None:
        return every
    for name in names:
        if name not in known:
            raise UsageError(f"argument --conditions: {unknown('condition', name, known)}")
    return {task: [one for one in several if one.name in names] for task, several in every.items()}


def attempts(args: argparse.Namespace) -> list[Attempt]:
    """List every policy under every condition.

    :param args: see :func:`add_arguments`.
    :return: the attempts.
    :raises UsageError: for an unknown condition.
    """
    return [
        Attempt(task, condition, label, policy)
        for task, several in _conditions(args.conditions).items()
        for condition in several
        for label, policy in entrants(task, getattr(args, task)).items()
        if policy != EXPERT or condition.expert
    ]


def measure(args: argparse.Namespace) -> dict[str, Any]:
    """Try every policy under every condition.

    :param args: see :func:`add_arguments`.
    :return: JSON-able: ``outcomes``, ``conditions``, ``trials`` and, if asked for, ``videos``.
    """
    from tqdm import tqdm

    found, todo = [], attempts(args)
    for attempt in todo:  # Report policies that do not fit before the first trial.
        resolve(attempt.policy, attempt.env_id, attempt.condition.options)
    for attempt in tqdm(todo, "transfer", unit="attempt", dynamic_ncols=True):
        trials = attempt.play(args.trials, args.seed)
        found.append((attempt, trials, [find_failure(attempt.task, one) for one in trials]))
    figures: dict[str, Any] = {
        "title": "Transfer",
        "kind": "transfer",
        "trials": args.trials,
        "seed": args.seed,
        "outcomes": [_row(one) for one in found],
        "conditions": {
            task: [asdict(one) for one in several]
            for task, several in _conditions(args.conditions).items()
        },
    }
    if args.video_dir is not None:
        from reproduction.transfer.videos import record_each_kind

        figures["videos"] = record_each_kind(args.video_dir, found, args.trials, args.seed)
    return figures


def _row(played: Played) -> dict[str, Any]:
    attempt, trials, failures = played
    successes = sum(one.success for one in trials)
    policy = attempt.policy
    causes = Counter(one.cause for one in failures if one is not None)
    return {
        "task": attempt.task,
        "condition": attempt.condition.name,
        "label": attempt.label,
        # Without the folder, which belongs to the machine.
        "policy": Path(policy).name if Path(policy).is_absolute() else policy,
        "env": attempt.env_id,
        "trials": len(trials),
        "successes": successes,
        "ci95": success_interval(successes, len(trials)),
        "causes": dict(sorted(causes.items())),
        "touched": sum(bool(one.collided.any()) for one in trials),
        "final_distance_mean": float(sum(one.distance[-1].mean() for one in trials) / len(trials)),
    }
