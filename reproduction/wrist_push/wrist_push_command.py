"""Evaluate the whole robot over many trials, with and without faults, as in chapter 8.

Four control loops play the same trials: with the true state or with camera and pose network, each
with exact or learned inverse kinematics. Then every fault is injected into the loop in which
everything is learned.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from reproduction.command_parts import add_choices, shares
from saver_advisors.cli.arguments import add_count, add_json, add_path, add_table
from saver_advisors.cli.measured import hand_over, measured_or_read, read_measurement
from saver_advisors.reporting.errors import UsageError
from saver_advisors.reporting.provenance import machine_in_words
from saver_advisors.reporting.tables import Column, join_parts, markdown, row_cells, rows_table
from saver_advisors.training.threads import one_thread_of_algebra

EXAMPLES = """\
examples:
  python -m reproduction wrist-push --trials 200 --processes 2 --json result.json --table page.md
  python -m reproduction wrist-push --trials 20 --rows true-state-exact everything-learned
  python -m reproduction wrist-push --policy expert --injections 0
  python -m reproduction wrist-push --from rows.json faults.json --table page.md"""

#: Name of a row -> whether it uses camera and pose network, and whether its kinematics are learned.
ROWS: Final[Mapping[str, tuple[bool, bool]]] = {
    "true-state-exact": (False, False),
    "true-state-learned": (False, True),
    "network-exact": (True, False),
    "everything-learned": (True, True),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    from saver_advisors.cli.run import add_loop_arguments

    add_count(parser, "--trials", 200, "trials of each row")
    add_count(parser, "--seed", 0, "seed of trial 0", least=0)
    add_choices(parser, "--rows", tuple(ROWS), "rows of the table", nargs="*")
    add_count(parser, "--injections", 20, "injections of each fault; 0 omits that table", least=0)
    add_count(parser, "--processes", 1, "processes that share the trials")
    add_loop_arguments(parser)
    add_table(parser)
    text = "show the JSON files of earlier measurements instead of measuring, in one table"
    add_path(parser, "--from", text, dest="from_json", nargs="+")
    add_json(parser)


@one_thread_of_algebra()
def run(args: argparse.Namespace) -> int:
    """Measure, print the page, and write the requested files.

    :param args: see :func:`add_arguments`.
    :return: exit status.
    :raises UsageError: for files that cannot be read or do not belong together.
    """
    if args.from_json is None:
        figures = measured_or_read(args, "wrist-push", lambda: measure(args))
    else:
        figures = joined([read_measurement(path, "wrist-push") for path in args.from_json])
    hand_over(render(figures), figures, args.json, args.table)
    return 0


def measure(args: argparse.Namespace) -> dict[str, Any]:
    """Play every row's trials, and inject every fault.

    :param args: see :func:`add_arguments`.
    :return: JSON-able: ``rows``, ``faults``, and the settings.
    """
    from reproduction.wrist_push.loop_trials import fault_row, play_row
    from saver_advisors.cli.run import settings_of
    from saver_advisors.integration.faults import FAULTS

    base = settings_of(args)
    figures: dict[str, Any] = {
        "title": "Wrist push",
        "kind": "wrist-push",
        "trials": args.trials,
        "seed": args.seed,
        "processes": args.processes,
        "settings": base.to_mapping(),
        "rows": [],
        "faults": [],
    }
    with shares(args.processes) as share:
        for name in args.rows:
            seeing, learned = ROWS[name]
            settings = replace(base, seeing=seeing, learned_kinematics=learned)
            row = play_row(share, settings, args.trials, args.seed)
            figures["rows"].append({"row": name, **row})
        for fault in FAULTS if args.injections else ():
            figures["faults"].append(fault_row(share, base, fault, args.injections, args.seed))
    return figures


def joined(measured: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Join separate measurements into one.

    :param measured: the measurements, whose settings may differ in the policy only.
    :return: rows and faults of all; a row whose policy is not the first measurement's names it.
    :raises UsageError: for different settings or first seeds, or for a row that occurs twice.
    """
    first = measured[0]
    if len(measured) == 1:
        return first
    rows, faults = [], []
    for one in measured:
        policy = one["settings"]["policy"]
        for name in ("limits", "filter", "latencies"):
            if one["settings"][name] != first["settings"][name]:
                raise UsageError(f"argument --from: the files differ in {name}")
        if one["seed"] != first["seed"]:
            raise UsageError("argument --from: the files differ in seed")
        told = {} if policy == first["settings"]["policy"] else {"policy": policy}
        rows += [{**row, **told} for row in one["rows"]]
        faults += one["faults"]
    names = [(row["row"], row.get("policy")) for row in rows]
    for name, policy in names:
        if names.count((name, policy)) > 1:
            raise UsageError(f"argument --from: row {name!r} occurs twice")
    origins = [one["provenance"] for one in measured]
    rows.sort(key=lambda row: ("policy" in row, list(ROWS).index(row["row"])))
    return {**first, "rows": rows, "faults": faults, "sources": origins}


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
