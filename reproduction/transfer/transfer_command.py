"""Run Jaco policies on two MICOs with other objects and sensors, and compare with Table 5.4.

Each policy runs unchanged on the dual MICO scenes: first on the plain scenes, then with one
difference at a time, then with all of them. A failed trial has one cause, derived from its
trajectory.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from reproduction.page_templates import page
from reproduction.transfer.attempts import EXPERT, TITLES, Attempt, Condition, Played, conditions
from reproduction.transfer.failures import PICK_CAUSES, PUSH_CAUSES, WORDS, find_failure
from saver_advisors.cli.arguments import add_count, add_folder, add_page
from saver_advisors.cli.measured import measure_and_render
from saver_advisors.cli.policies import SIDE_BY_SIDE
from saver_advisors.evaluation.statistics import success_interval
from saver_advisors.pretrained import load_policy, shipped_policies
from saver_advisors.reporting.errors import UsageError, unknown
from saver_advisors.reporting.provenance import measured_at
from saver_advisors.reporting.tables import Column, link, markdown, rows_table
from saver_envs.files import read_json
from saver_envs.sensor_errors import SENSORS

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
    text = "folder for videos of a success and of each cause of failure, as MP4 and as WebP"
    add_folder(parser, "--video-dir", text)
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
    :return: JSON-able: ``outcomes``, ``conditions``, ``weights``, ``sensors``, ``trials`` and, if
        asked for, ``videos``.
    """
    from tqdm import tqdm

    found, todo = [], attempts(args)
    for attempt in todo:  # Report policies that do not fit before the first trial.
        attempt.predict()
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
        "weights": _weights([one.policy for one in todo]),
        "sensors": [asdict(one) for one in SENSORS],
    }
    if args.video_dir is not None:
        from reproduction.transfer.videos import record_each_kind

        figures["videos"] = record_each_kind(args.video_dir, found, args.trials, args.seed)
    return figures


def _weights(policies: Sequence[str]) -> list[dict[str, Any]]:
    """List the weight files of policies with what their cards say about their training."""
    names = [one.removeprefix(f"{SIDE_BY_SIDE}:") for one in dict.fromkeys(policies)]
    files = [one for one in names if one in shipped_policies() or Path(one).is_file()]
    cards = {Path(one).stem: load_policy(one).card for one in files}
    return [
        {"name": name, "env": card.environment, "steps": card.steps, "commit": card.commit}
        for name, card in cards.items()
    ]


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


PAPER: Final = Path(__file__).with_name("paper.json")
CAUSES: Final = {"push": PUSH_CAUSES, "pick": PICK_CAUSES}
HEADLINE: Final = "all"
SUCCESS: Final = "{successes}/{trials}"
INTERVAL: Final = "{ci95[0]:.2f} to {ci95[1]:.2f}"

WEIGHT_COLUMNS: Final = {
    "weights": "`{name}`",
    "environment": "{env}",
    "steps": "{steps:,}",
    "commit": "`{commit}`",
}
SENSOR_COLUMNS: Final = {
    "reading": "{part}",
    "each step": "{deviation:g}",
    "each episode": "{offset:g}",
}


def render(figures: Mapping[str, Any], clips: str | None = None) -> str:
    """Render the figures as a page.

    :param figures: what was measured, or the content of its JSON file.
    :param clips: folder of the videos relative to the page; no videos if None.
    :return: Markdown.
    """
    every = [one for several in figures["conditions"].values() for one in several]
    return page(
        "transfer",
        clips=clips,
        titles=TITLES,
        words=WORDS,
        headline=_headline(figures["outcomes"]),
        tables={task: _table(task, figures["outcomes"]) for task in TITLES},
        noisy=any("sensor_noise" in one["randomization"] for one in every),
        of_weights=WEIGHT_COLUMNS,
        of_sensors=SENSOR_COLUMNS,
        origin=measured_at(figures),
        # "renamed": names that policies have been given since; the command is as it was typed.
        **{"videos": [], "renamed": {}, **figures},
    )


def paper_rows() -> dict[tuple[str, str], dict[str, Any]]:
    """Read Table 5.4.

    :return: its rows by task and policy.
    """
    content = read_json(PAPER)
    return {
        (one["task"], one["policy"]): {**one, "trials": content["trials"]}
        for one in content["rows"]
    }


def _headline(outcomes: Sequence[Mapping[str, Any]]) -> str:
    """Render the condition with all differences next to the paper's rows."""
    columns = ["task", "policy", "success here", "95% interval", "failures here"]
    columns += ["paper, on real arms", "failures there"]
    ours = {(one["task"], one["label"]): one for one in outcomes if one["condition"] == HEADLINE}
    paper = paper_rows()
    rows = []
    for key in sorted({**ours, **paper}, key=lambda key: list(TITLES).index(key[0])):
        cells = ["-", "-", "not tried", "-", "-"]
        if one := ours.get(key):
            cells[:3] = [SUCCESS.format_map(one), INTERVAL.format_map(one), _failures(one)]
        if one := paper.get(key):
            cells[3:] = [SUCCESS.format_map(one), _failures(one)]
        rows.append([TITLES[key[0]], key[1], *cells])
    return markdown(columns, rows)


def _failures(one: Mapping[str, Any]) -> str:
    """Count the failures by cause; the paper does not do so for all of its rows."""
    ordered = sorted(one["causes"].items(), key=lambda item: -item[1])
    told = ", ".join(f"{count} {WORDS[cause]}" for cause, count in ordered)
    return told or one.get("words", "none")


def _table(task: str, outcomes: Sequence[Mapping[str, Any]]) -> str:
    """Render all conditions of a task; empty if it was not tried."""
    columns: dict[str, Column] = {
        "condition": "{condition}",
        "policy": "{label}",
        "success": SUCCESS,
        "95% interval": INTERVAL,
    }
    # 0 for other causes
    rows = [{**one, "causes": Counter(one["causes"])} for one in outcomes if one["task"] == task]
    for cause in CAUSES[task]:
        if any(row["causes"][cause] for row in rows):
            columns[WORDS[cause]] = f"{{causes[{cause}]}}"
    columns["touched"] = "{touched}"
    columns["final distance (cm)"] = lambda row: f"{100 * row['final_distance_mean']:.1f}"
    return rows_table(rows, columns) if rows else ""
