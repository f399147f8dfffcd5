"""Render the trials of the whole robot as a page, next to the paper's figures."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from saver_advisors.reporting.provenance import machine_in_words
from saver_advisors.reporting.tables import Column, join_parts, markdown, row_cells, rows_table

PAPER: Final = Path(__file__).with_name("paper.json")
WORDS: Final = {
    "true-state-exact": "true state, exact kinematics",
    "true-state-learned": "true state, learned kinematics",
    "network-exact": "pose network, exact kinematics",
    "everything-learned": "everything learned",
}

INTRODUCTION: Final = """\
Generated from the JSON files of `python -m reproduction wrist-push`. Every row plays the given
number of trials of `WristPush-v0` through the loop of [Integration](integration.md). All rows start
from the same seed, and trials differ in body, posture and position. A trial *succeeded* if both
wrists end within 5 cm of their targets and the trunk was never pressed with more than 50 N nor
moved by more than 20 mm. It *failed in reaching* if a wrist that missed its target was never
brought 2 cm nearer to it, which means that the hand did not come to push it. Otherwise it *failed
in pushing*. *Harmed* counts trials beyond a limit of the trunk.
"""

FAULTS: Final = """\
Each fault is injected into the loop with everything learned while the arms move, for 0.6 s. *Stood*
is the time from the start of the fault until both tools are slower than 1 cm/s and stay so while it
lasts. *Named* counts cases in which the log names the faulty stage, or the stage that checks its
results. *Went on* is the time from the end of the fault until the arms are released. Force and
displacement are the maxima of all cases, from the start of the fault.
"""

STAGES: Final = """\
Rate in simulated time; wall-clock time of a call on this machine. The simulated latencies are
settings of the loop.
"""


def render(figures: Mapping[str, Any]) -> str:
    """Render the figures as a page.

    :param figures: what was measured, or the content of its JSON file.
    :return: Markdown.
    """
    parts = ["# The whole robot", INTRODUCTION, "## Beside chapter 8's table", _table(figures)]
    parts.append(_causes(figures["rows"]))
    if figures["faults"]:
        parts += ["## Faults", FAULTS, rows_table(figures["faults"], FAULT_COLUMNS)]
    parts += ["## Rates and latencies", STAGES, rows_table(figures["rows"], SPEED_COLUMNS)]
    return join_parts([*parts, *_stages(figures), _origin(figures)])


def _words(row: Mapping[str, Any]) -> str:
    """Name a row, with its policy if that is not the table's."""
    words = WORDS[row["row"]]
    return f"{words}, policy `{row['policy']}`" if "policy" in row else words


def _spread(values: Sequence[float] | None) -> str:
    return "-" if values is None else f"{values[0]:.0f}, {values[1]:.0f}"


FAULT_COLUMNS: Final[Mapping[str, Column]] = {
    "fault": "{fault}: {words}",
    "cases": "{injections}",
    "stood": "{stopped}",
    "within 100 ms": "{stopped_in_time}",
    "until standing: median, longest (ms)": lambda one: _spread(one["still_ms"]),
    "named": "{named_rightly}",
    "went on": "{recovered}",
    "until release: median, longest (ms)": lambda one: _spread(one["recovery_ms"]),
    "force (N)": "{torso_force_n:.0f}",
    "displacement (mm)": lambda one: f"{1000 * one['torso_displacement_m']:.1f}",
}
SPEED_COLUMNS: Final[Mapping[str, Column]] = {
    "loop": _words,
    "simulated s per s, one process": "{real_time_share:.2f}",
    "all processes": "{throughput:.2f}",
    "wall clock per trial (s)": "{wall_s_per_trial:.1f}",
    "age of the policy's input, median and 95% (ms)": "{age_ms[0]:.0f}, {age_ms[1]:.0f}",
}
OUTCOME_COLUMNS: Final[Mapping[str, Column]] = {
    "loop": _words,
    "trials": "{trials}",
    "succeeded": "{succeeded}",
    "rate": lambda one: f"{one['succeeded'] / one['trials']:.2f}",
    "95% interval": "{ci95[0]:.2f} to {ci95[1]:.2f}",
    "failed in reaching": "{failed_reaching}",
    "failed in pushing": "{failed_pushing}",
    "harmed": "{harmed}",
}


def _table(figures: Mapping[str, Any]) -> str:
    paper = json.loads(PAPER.read_text(encoding="utf-8"))
    theirs = {"loop": "paper, on real arms", "95% interval": "-", "harmed": "-"}
    rows = row_cells(figures["rows"], OUTCOME_COLUMNS.values())
    rows += row_cells([paper], [theirs.get(name, one) for name, one in OUTCOME_COLUMNS.items()])
    settings = figures["settings"]
    speed = settings["limits"]["max_speed"]
    told = f"Policy: `{settings['policy']}`; tools at up to {speed:g} m/s; seeds from "
    return f"{told}{figures['seed']}.\n\n{markdown(list(OUTCOME_COLUMNS), rows)}"


def _causes(rows: Sequence[Mapping[str, Any]]) -> str:
    """List what stopped the arms most often."""
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
    return "The most frequent stops by the safety layer:\n\n" + "\n".join(lines) + "\n"


def _stages(figures: Mapping[str, Any]) -> list[str]:
    """Render the stages of the row with most stages."""
    if not figures["rows"]:
        return []
    fullest = max(figures["rows"], key=lambda one: len(one["stages"]))
    latencies = figures["settings"]["latencies"]

    def latency(one: Mapping[str, Any]) -> str:
        value = latencies.get(one["name"], 0.0)
        return value if isinstance(value, str) else f"{1000 * value:g}"

    columns: dict[str, Column] = {
        "stage": "{name}",
        "rate (Hz)": "{rate_hz:.1f}",
        "median (ms)": "{median_ms:.3f}",
        "95% (ms)": "{p95_ms:.3f}",
        "simulated latency (ms)": latency,
    }
    stages = [{"name": name, **one} for name, one in fullest["stages"].items()]
    return [f"Stages of *{_words(fullest)}*:\n", rows_table(stages, columns)]


def _origin(figures: Mapping[str, Any]) -> str:
    return "\n".join(
        f"`{origin['command']}`, commit {origin['commit'] or 'unknown'}, {origin['time']}, "
        f"{machine_in_words(origin['machine'])}.\n"
        for origin in figures.get("sources") or [figures["provenance"]]
    )
