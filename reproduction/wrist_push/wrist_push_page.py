"""The trials of the whole robot as a page of Markdown, beside the paper's figures."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from saver_advisors.reporting.provenance import machine_in_words
from saver_advisors.reporting.tables import markdown

PAPER: Final = Path(__file__).with_name("paper.json")
WORDS: Final = {
    "true-state-exact": "true state, exact kinematics",
    "true-state-learned": "true state, learned kinematics",
    "network-exact": "pose network, exact kinematics",
    "everything-learned": "everything learned",
}

INTRODUCTION: Final = """\
Rendered from the JSON files of `python -m reproduction wrist-push`, never typed. Every row plays
the same trials of `WristPush-v0` from the first on (other bodies, postures and places from trial to
trial), as many as it says, through the loop of [Integration](integration.md). A trial *succeeded*
where both wrists end within 5 cm of their targets and the trunk was never pressed with more than 50
N nor moved by more than 20 mm. It *failed in reaching* where a wrist that missed was never brought
2 cm nearer to its target: the hand never came to push it. Else it *failed in pushing*. *Harmed*
counts trials beyond a limit of the trunk's.
"""

FAULTS: Final = """\
Each fault is injected into the loop with everything learned while the arms move, for 0.6 s. *Stood*
is the time from the fault's begin until both tools are slower than 1 cm/s, and stay so while it
lasts. *Named* counts cases in which the log names the stage at fault, or the one that checks its
results. *Went on* is the time from the fault's end until the arms are free again. Force and
displacement are the highest of all cases, from the fault's begin on.
"""

STAGES: Final = """\
Rate in simulated time; wall-clock time of a call on this machine. The simulated latencies are
settings of the loop.
"""


def render(figures: Mapping[str, Any]) -> str:
    """The figures as a page.

    :param figures: what was measured, or its JSON file's content
    :return: Markdown
    """
    parts = ["# The whole robot", INTRODUCTION, "## Beside chapter 8's table", _table(figures)]
    parts += [_causes(figures["rows"])]
    if figures["faults"]:
        parts += ["## Faults", FAULTS, _fault_table(figures["faults"])]
    parts += ["## Rates and latencies", STAGES, _speed(figures["rows"]), *_stages(figures)]
    parts.append(_origin(figures))
    return "\n".join(part.rstrip("\n") + "\n" for part in parts)


def _table(figures: Mapping[str, Any]) -> str:
    paper = json.loads(PAPER.read_text(encoding="utf-8"))
    columns = ["loop", "trials", "succeeded", "rate", "95% interval"]
    columns += ["failed in reaching", "failed in pushing", "harmed"]
    rows = []
    for one in figures["rows"]:
        low, high = one["ci95"]
        rows.append(
            [
                _words(one),
                str(one["trials"]),
                str(one["succeeded"]),
                f"{one['succeeded'] / one['trials']:.2f}",
                f"{low:.2f} to {high:.2f}",
                str(one["failed_reaching"]),
                str(one["failed_pushing"]),
                str(one["harmed"]),
            ]
        )
    theirs = [str(paper[key]) for key in ("failed_reaching", "failed_pushing")]
    rate = f"{paper['succeeded'] / paper['trials']:.2f}"
    row = ["paper, on real arms", str(paper["trials"]), str(paper["succeeded"]), rate, "-"]
    rows.append([*row, *theirs, "-"])
    settings = figures["settings"]
    speed = settings["limits"]["max_speed"]
    told = f"Policy: `{settings['policy']}`; tools at up to {speed:g} m/s; seeds from "
    return f"{told}{figures['seed']}.\n\n{markdown(columns, rows)}"


def _causes(rows: Sequence[Mapping[str, Any]]) -> str:
    """What stopped the arms most often."""
    lines = []
    for one in rows:
        stops = Counter(
            stop.split("stopped", 1)[1].strip()
            for trial in one["outcomes"]
            for stop in trial["stops"]
        )
        told = "; ".join(f"{words} ({count})" for words, count in stops.most_common(4))
        held = 100 * one["held_share"]
        lines.append(f"- {_words(one)}: held for {held:.1f}% of the time. {told or 'None'}.")
    return "Stops by the safety layer, the most frequent ones:\n\n" + "\n".join(lines) + "\n"


def _fault_table(faults: Sequence[Mapping[str, Any]]) -> str:
    columns = ["fault", "cases", "stood", "within 100 ms", "median, longest (ms)", "named"]
    columns += ["went on", "median, longest (ms)", "force (N)", "displacement (mm)"]
    rows = [
        [
            f"{one['fault']}: {one['words']}",
            str(one["injections"]),
            str(one["stopped"]),
            str(one["stopped_in_time"]),
            _spread(one["still_ms"]),
            str(one["named_rightly"]),
            str(one["recovered"]),
            _spread(one["recovery_ms"]),
            f"{one['torso_force_n']:.0f}",
            f"{1000 * one['torso_displacement_m']:.1f}",
        ]
        for one in faults
    ]
    return markdown(columns, rows)


def _spread(values: Sequence[float] | None) -> str:
    return "-" if values is None else f"{values[0]:.0f}, {values[1]:.0f}"


def _speed(rows: Sequence[Mapping[str, Any]]) -> str:
    columns = ["loop", "share of real time, a process", "all processes", "wall clock a trial (s)"]
    columns.append("age of what the policy sees, median and 95% (ms)")
    return markdown(
        columns,
        [
            [
                _words(one),
                f"{one['real_time_share']:.2f}",
                f"{one['throughput']:.2f}",
                f"{one['wall_s_per_trial']:.1f}",
                "{:.0f}, {:.0f}".format(*one["age_ms"]),
            ]
            for one in rows
        ],
    )


def _stages(figures: Mapping[str, Any]) -> list[str]:
    """The stages of the fullest row."""
    if not figures["rows"]:
        return []
    fullest = max(figures["rows"], key=lambda one: len(one["stages"]))
    latencies = figures["settings"]["latencies"]
    columns = ["stage", "rate (Hz)", "median (ms)", "95% (ms)", "simulated latency (ms)"]
    rows = [
        [
            name,
            f"{one['rate_hz']:.1f}",
            f"{one['median_ms']:.3f}",
            f"{one['p95_ms']:.3f}",
            _latency(latencies.get(name, 0.0)),
        ]
        for name, one in fullest["stages"].items()
    ]
    return [f"Stages of *{_words(fullest)}*:\n", markdown(columns, rows)]


def _latency(value: float | str) -> str:
    return value if isinstance(value, str) else f"{1000 * value:g}"


def _words(row: Mapping[str, Any]) -> str:
    """What a row is called; with its policy where that is another than the table's."""
    words = WORDS[row["row"]]
    return f"{words}, policy `{row['policy']}`" if "policy" in row else words


def _origin(figures: Mapping[str, Any]) -> str:
    lines = []
    for origin in figures.get("sources") or [figures["provenance"]]:
        lines.append(
            f"`{origin['command']}`, commit {origin['commit'] or 'unknown'}, {origin['time']}, "
            f"{machine_in_words(origin['machine'])}.\n"
        )
    return "\n".join(lines)
