"""Render the transfer study as a page, next to the dissertation's figures."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from reproduction.command_parts import measured_at
from reproduction.transfer import failures
from reproduction.transfer.attempts import TITLES
from saver_advisors.reporting.tables import Column, join_parts, markdown, rows_table

PAPER: Final = Path(__file__).with_name("paper.json")
CAUSES: Final = {"push": failures.PUSH_CAUSES, "pick": failures.PICK_CAUSES}
HEADLINE: Final = "all"
SUCCESS: Final = "{successes}/{trials}"
INTERVAL: Final = "{ci95[0]:.2f} to {ci95[1]:.2f}"

INTRODUCTION: Final = """\
Generated from the JSON file of `python -m reproduction transfer`. In the dissertation's Table 5.4,
policies that were trained on two simulated Jacos run on two real MICOs. Here they run, unchanged,
on two simulated MICOs, which have four joints, two fingers and a shorter reach, with other objects
and with sensor noise.
"""

HAND: Final = """\
A policy observes finger angles, and was trained with those of the Jaco. The MICO's readings are
translated into the Jaco's angles, from open to closed, as any use of a policy with another hand
requires; the rows *raw* show the result without translation. Success is computed from the true
positions of the cubes, without noise.
"""

CAUSE_WORDS: Final = """\
A failed trial has one cause, the first event that went wrong; `reproduction.transfer.failures`
defines the causes. *Touched* counts trials, including successful ones, with any contact between
arms, or of an arm with the table or with the cube of another arm; as a cause of failure, contact
has to last for 0.12 s.
"""


def render(figures: Mapping[str, Any], clips: str | None = None) -> str:
    """Render the figures as a page.

    :param figures: what was measured, or the content of its JSON file.
    :param clips: folder of the videos relative to the page; no videos if None.
    :return: Markdown.
    """
    parts = ["# Transfer", INTRODUCTION, "## Comparison with Table 5.4", _headline(figures)]
    parts += [HAND, CAUSE_WORDS]
    for task, title in TITLES.items():
        rows = [one for one in figures["outcomes"] if one["task"] == task]
        if rows:
            parts += [f"## {title}, one difference at a time", _conditions(task, figures)]
            parts.append(_table(task, rows))
    if clips is not None and figures.get("videos"):
        parts += ["## Videos", _videos(figures["videos"], clips)]
    parts += ["## Sensors", _sensors(figures), _origin(figures)]
    return join_parts(parts)


def paper_rows() -> dict[tuple[str, str], dict[str, Any]]:
    """Read Table 5.4.

    :return: its rows by task and policy.
    """
    content = json.loads(PAPER.read_text(encoding="utf-8"))
    return {
        (one["task"], one["policy"]): {**one, "trials": content["trials"]}
        for one in content["rows"]
    }


def _headline(figures: Mapping[str, Any]) -> str:
    """Render the condition with all differences next to the paper's rows."""
    paper = paper_rows()
    columns = ["task", "policy", "success here", "95% interval", "failures here"]
    columns += ["paper, on real arms", "failures there"]
    rows = []
    for task in TITLES:
        ours = {
            one["label"]: one
            for one in figures["outcomes"]
            if (one["task"], one["condition"]) == (task, HEADLINE)
        }
        for label in dict.fromkeys([*ours, *(policy for name, policy in paper if name == task)]):
            cells = _ours(ours.get(label))
            rows.append([TITLES[task], label, *cells, *_theirs(paper.get((task, label)))])
    return markdown(columns, rows)


def _ours(one: Mapping[str, Any] | None) -> list[str]:
    if one is None:
        return ["-", "-", "not tried"]
    return [SUCCESS.format_map(one), INTERVAL.format_map(one), _failures(one)]


def _theirs(one: Mapping[str, Any] | None) -> list[str]:
    if one is None:
        return ["-", "-"]
    told = _failures(one) if one["causes"] else one["words"]
    return [SUCCESS.format_map(one), told]


def _failures(one: Mapping[str, Any]) -> str:
    ordered = sorted(one["causes"].items(), key=lambda item: -item[1])
    return ", ".join(f"{count} {failures.WORDS[cause]}" for cause, count in ordered) or "none"


def _conditions(task: str, figures: Mapping[str, Any]) -> str:
    lines = [f"- *{one['name']}*: {one['words']}" for one in figures["conditions"][task]]
    return "\n".join(lines) + "\n"


def _table(task: str, rows: Sequence[Mapping[str, Any]]) -> str:
    columns: dict[str, Column] = {
        "condition": "{condition}",
        "policy": "{label}",
        "success": SUCCESS,
        "95% interval": INTERVAL,
    }
    rows = [{**row, "causes": Counter(row["causes"])} for row in rows]  # 0 for other causes
    for cause in CAUSES[task]:
        if any(row["causes"][cause] for row in rows):
            columns[failures.WORDS[cause]] = f"{{causes[{cause}]}}"
    columns["touched"] = "{touched}"
    columns["final distance (cm)"] = lambda row: f"{100 * row['final_distance_mean']:.1f}"
    return rows_table(rows, columns)


def _videos(videos: Sequence[Mapping[str, Any]], clips: str) -> str:
    parts = []
    for one in videos:
        words = failures.WORDS.get(one["kind"], one["kind"])
        told = f"{TITLES[one['task']]}, {words}"
        parts.append(
            f"![{told}]({clips}/{one['file']}.webp)\n\n*{told}*: {one['label']}, condition "
            f"*{one['condition']}*, seed {one['seed']} ([MP4]({clips}/{one['file']}.mp4))\n"
        )
    return "\n".join(parts)


def _sensors(figures: Mapping[str, Any]) -> str:
    every = [one["noise"] for several in figures["conditions"].values() for one in several]
    noise = next((one for one in every if one is not None), None)
    if noise is None:
        return "Sensors were exact.\n"
    rows = [[name.replace("_", " "), f"{value:g}"] for name, value in noise.items()]
    text = "Standard deviations, SI units, see `saver_envs.wrappers.sensor_noise`.\n\n"
    return text + markdown(["reading", "standard deviation"], rows)


def _origin(figures: Mapping[str, Any]) -> str:
    # Names that policies have been given since are in the file; the command is as it was typed.
    renamed = "".join(
        f"The policy `{old}` of this command is now `{new}`. "
        for old, new in figures.get("renamed", {}).items()
    )
    return (
        f"Trials start from seeds {figures['seed']} and up, the same for every policy. "
        f"{measured_at(figures)} {renamed}Contact is chaotic: single trials differ between "
        "machines, but rates stay within their intervals."
    )
