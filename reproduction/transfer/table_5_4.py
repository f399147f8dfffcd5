"""Policies of the Jaco on two MICOs, with other objects and sensors, beside Table 5.4.

Each policy runs unchanged on the dual MICO scenes, first as they are, then with one thing different
at a time, then with all of them. A failed trial has one cause, told from its trajectory.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from reproduction.transfer.attempts import (
    EXPERT,
    STUDENTS,
    TEACHERS,
    TITLES,
    Attempt,
    Entrant,
)
from saver_advisors.cli.measured import hand_over, measured_or_read
from saver_advisors.training.threads import one_thread_of_algebra

if TYPE_CHECKING:
    from reproduction.transfer.conditions import Condition
    from reproduction.transfer.failures import Failure
    from reproduction.transfer.trajectories import Trajectory

EXAMPLES: Final = """\
examples:
  python -m reproduction transfer --json transfer.json --table transfer.md --video-dir videos
  python -m reproduction transfer --pick --push advised=dual-jaco-push-advised
  python -m reproduction transfer --conditions mico all --trials 10
  python -m reproduction transfer --from transfer.json --table transfer.md

policies:
  [LABEL=]POLICY with a POLICY as `saver evaluate` takes it: a shipped name, a weight file, a run's
  folder, side-by-side:TEACHER, expert. The labels advised and scratch stand beside the paper's."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    from saver_advisors.cli.arguments import add_page, at_least

    for task, title in TITLES.items():
        parser.add_argument(
            f"--{task}",
            nargs="*",
            metavar="[LABEL=]POLICY",
            help=f"who tries {title.lower()}; none of them leaves it out (default: the advised "
            "student where it ships, teachers side by side, the scripted expert)",
        )
    parser.add_argument(
        "--conditions", nargs="+", metavar="NAME", help="of those in the table (default: all)"
    )
    parser.add_argument(
        "--trials", type=at_least(1), default=50, metavar="N", help="each (default: 50)"
    )
    parser.add_argument(
        "--seed", type=at_least(0), default=0, metavar="S", help="of trial 0 (default: 0)"
    )
    parser.add_argument(
        "--video-dir",
        type=Path,
        metavar="DIR",
        help="record a success and each kind of failure that occurred there, as MP4 and as WebP",
    )
    add_page(parser)


@one_thread_of_algebra()
def run(args: argparse.Namespace) -> int:
    """Measure, show, and write where asked for.

    :param args: see :func:`add_arguments`
    :return: exit status
    """
    from reproduction.transfer.transfer_page import render

    figures = measured_or_read(args, "transfer", lambda: measure(args))
    page = render(figures, _relative(args.video_dir, args.table))
    hand_over(page, figures, args.json, args.table)
    return 0


def _relative(videos: Path | None, table: Path | None) -> str | None:
    """Where the videos are, as the page sees them."""
    import os

    if videos is None:
        return None
    start = Path.cwd() if table is None else table.resolve().parent
    return Path(os.path.relpath(videos.resolve(), start)).as_posix()


def entrants(task: str, words: Sequence[str] | None) -> list[Entrant]:
    """Who tries a task.

    :param task: ``push`` or ``pick``
    :param words: ``[LABEL=]POLICY`` each; the default ones where None
    :return: in order
    :raises UsageError: for two of the same label
    """
    from saver_advisors.pretrained import shipped_policies
    from saver_advisors.reporting.errors import UsageError

    if words is None:
        student = [Entrant("advised", STUDENTS[task])]
        return [
            *(student if STUDENTS[task] in shipped_policies() else []),
            Entrant("teachers side by side", f"side-by-side:{TEACHERS[task]}"),
            Entrant("scripted expert", EXPERT),
        ]
    found = []
    for word in words:
        label, equals, policy = word.partition("=")
        found.append(Entrant(label, policy) if equals else Entrant(word, word))
    labels = [one.label for one in found]
    if len(set(labels)) < len(labels):
        raise UsageError(f"argument --{task}: {labels} must have a label of its own each")
    return found


def _chosen(task: str, names: Sequence[str] | None) -> list[Condition]:
    from reproduction.transfer.conditions import conditions

    return [one for one in conditions(task) if names is None or one.name in names]


def _check_conditions(names: Sequence[str] | None) -> None:
    from reproduction.transfer.conditions import conditions
    from saver_advisors.reporting.errors import UsageError, unknown

    known = list(dict.fromkeys(one.name for task in TITLES for one in conditions(task)))
    for name in names or ():
        if name not in known:
            raise UsageError(f"argument --conditions: {unknown('condition', name, known)}")


def attempts(args: argparse.Namespace) -> list[Attempt]:
    """Everything that is to be tried.

    :param args: see :func:`add_arguments`
    :raises UsageError: for an unknown condition
    """
    _check_conditions(args.conditions)
    return [
        Attempt(task, condition, entrant)
        for task in TITLES
        for condition in _chosen(task, args.conditions)
        for entrant in entrants(task, getattr(args, task))
        if entrant.policy != EXPERT or condition.expert
    ]


def measure(args: argparse.Namespace) -> dict[str, Any]:
    """Try every policy under every condition.

    :param args: see :func:`add_arguments`
    :return: JSON-able: ``rows``, ``conditions``, ``trials`` and, where asked for, ``videos``
    """
    from saver_advisors.benchmark.machine import progress

    found, todo = [], attempts(args)
    for attempt in todo:
        _check_policy(attempt)
    with progress("transfer", len(todo)) as advance:
        for attempt in todo:
            trials = attempt.play(args.trials, args.seed)
            found.append((attempt, trials, [attempt.failure(one) for one in trials]))
            advance()
    figures: dict[str, Any] = {
        "title": "Transfer",
        "kind": "transfer",
        "trials": args.trials,
        "seed": args.seed,
        "outcomes": [_row(*one) for one in found],
        "conditions": {
            task: [asdict(one) for one in _chosen(task, args.conditions)] for task in TITLES
        },
    }
    if args.video_dir is not None:
        from reproduction.transfer.videos import record_each_kind

        figures["videos"] = record_each_kind(args.video_dir, found, args.trials, args.seed)
    return figures


def _check_policy(attempt: Attempt) -> None:
    """Find a policy that does not fit before anything long begins."""
    from saver_advisors.cli.policies import resolve

    resolve(attempt.entrant.policy, attempt.env_id, attempt.condition.options)


def _row(
    attempt: Attempt, trials: Sequence[Trajectory], failures: Sequence[Failure | None]
) -> dict[str, Any]:
    from saver_advisors.evaluation.statistics import success_interval

    successes = sum(one.success for one in trials)
    causes = Counter(one.cause for one in failures if one is not None)
    return {
        "task": attempt.task,
        "condition": attempt.condition.name,
        "label": attempt.entrant.label,
        # A file's name is enough, and says nothing about the machine.
        "policy": _portable(attempt.entrant.policy),
        "env": attempt.env_id,
        "trials": len(trials),
        "successes": successes,
        "ci95": list(success_interval(successes, len(trials))),
        "causes": dict(sorted(causes.items())),
        "touched": sum(bool(one.collided.any()) for one in trials),
        "final_distance_mean": float(sum(one.distance[-1].mean() for one in trials) / len(trials)),
    }


def _portable(policy: str) -> str:
    return Path(policy).name if Path(policy).is_absolute() else policy
