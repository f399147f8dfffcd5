"""The transfer study as a page of Markdown, beside the dissertation's figures."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from reproduction.transfer import failures
from reproduction.transfer.attempts import TITLES
from saver_advisors.reporting.tables import markdown

PAPER: Final = Path(__file__).with_name("paper.json")
CAUSES: Final = {"push": failures.PUSH_CAUSES, "pick": failures.PICK_CAUSES}
HEADLINE: Final = "all"

INTRODUCTION: Final = """\
Rendered from the JSON file of `python -m reproduction transfer`, never typed. The dissertation's
Table 5.4 tries policies that were trained on two simulated Jacos on two real MICOs. Here they are
tried, unchanged, on two simulated MICOs, which have four joints, two fingers and a shorter reach,
with other objects and with sensors that err.
"""

HAND: Final = """\
A policy reads finger angles, and knows those of the Jaco. The MICO's readings are told to it in
the Jaco's angles, open as open and closed as closed, as whoever connects a policy to another hand
has to; the rows *raw* show what happens otherwise. Success is read from where the cubes truly are,
noise or not.
"""

CAUSE_WORDS: Final = """\
A failed trial has one cause, the first thing that went wrong;
`reproduction.transfer.failures` defines each by what is measured. *Touched* counts trials,
successful ones too, with any contact between arms, or of an arm with the table or a stranger's
cube; as a cause of failure, contact has to last for 0.12 s.
"""


def render(figures: Mapping[str, Any], clips: str | None = None) -> str:
    """The figures as a page.

    :param figures: what ``python -m reproduction transfer`` measured, or its JSON file's content
    :param clips: the folder of the videos as the page sees it; no videos where None
    :return: Markdown
    """
    parts = ["# Transfer", INTRODUCTION, "## Beside Table 5.4", _headline(figures)]
    parts += [HAND, CAUSE_WORDS]
    for task, title in TITLES.items():
        rows = [one for one in figures["outcomes"] if one["task"] == task]
        if rows:
            parts += [f"## {title}, one difference at a time", _conditions(task, figures)]
            parts.append(_table(task, rows))
    if clips is not None and figures.get("videos"):
        parts += ["## Videos", _videos(figures["videos"], clips)]
    parts += ["## Sensors", _sensors(figures), _origin(figures)]
    return "\n".join(part.rstrip("\n") + "\n" for part in parts)


def paper_rows() -> dict[tuple[str, str], dict[str, Any]]:
    """Table 5.4, by task and policy."""
    content = json.loads(PAPER.read_text(encoding="utf-8"))
    return {
        (one["task"], one["policy"]): {**one, "trials": content["trials"]}
        for one in content["rows"]
    }


def _headline(figures: Mapping[str, Any]) -> str:
    """The condition in which everything differs, beside the paper's rows."""
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
    low, high = one["ci95"]
    return [f"{one['successes']}/{one['trials']}", f"{low:.2f} to {high:.2f}", _failures(one)]


def _theirs(one: Mapping[str, Any] | None) -> list[str]:
    if one is None:
        return ["-", "-"]
    told = _failures(one) if one["causes"] else one["words"]
    return [f"{one['successes']}/{one['trials']}", told]


def _failures(one: Mapping[str, Any]) -> str:
    ordered = sorted(one["causes"].items(), key=lambda item: -item[1])
    return ", ".join(f"{count} {failures.WORDS[cause]}" for cause, count in ordered) or "none"


def _conditions(task: str, figures: Mapping[str, Any]) -> str:
    lines = [f"- *{one['name']}*: {one['words']}" for one in figures["conditions"][task]]
    return "\n".join(lines) + "\n"


def _table(task: str, rows: Sequence[Mapping[str, Any]]) -> str:
    causes = [one for one in CAUSES[task] if any(one in row["causes"] for row in rows)]
    columns = ["condition", "policy", "success", "95% interval"]
    columns += [*(failures.WORDS[one] for one in causes), "touched", "final distance (cm)"]
    cells = []
    for row in rows:
        low, high = row["ci95"]
        cells.append(
            [
                row["condition"],
                row["label"],
                f"{row['successes']}/{row['trials']}",
                f"{low:.2f} to {high:.2f}",
                *(str(row["causes"].get(one, 0)) for one in causes),
                str(row["touched"]),
                f"{100 * row['final_distance_mean']:.1f}",
            ]
        )
    return markdown(columns, cells)


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
    noise = next(
        (
            one["noise"]
            for several in figures["conditions"].values()
            for one in several
            if one["noise"] is not None
        ),
        None,
    )
    if noise is None:
        return "Sensors were exact.\n"
    rows = [[name.replace("_", " "), f"{value:g}"] for name, value in noise.items()]
    text = "Standard deviations, SI units; `saver_envs.wrappers.sensor_noise` says why.\n\n"
    return text + markdown(["reading", "standard deviation"], rows)


def _origin(figures: Mapping[str, Any]) -> str:
    text = f"Trials start from seeds {figures['seed']} and up, the same for every policy."
    origin = figures.get("provenance")
    if not origin:
        return text
    return (
        f"{text} Measured at commit `{origin['commit']}` with `{origin['command']}`, MuJoCo "
        f"{origin['versions']['mujoco']}. Contact is chaotic: another machine gives other trials, "
        "and rates within their intervals."
    )
