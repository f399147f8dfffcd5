"""Evaluate the whole robot over many trials, with and without faults, as in chapter 8.

Four control loops play the same trials: with the true state or with camera and pose network, each
with exact or learned inverse kinematics. Then every fault is injected into the loop in which
everything is learned.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from reproduction.command_parts import add_choices, shares
from reproduction.page_templates import page
from saver_advisors.cli.arguments import add_count, add_json, add_path, add_table
from saver_advisors.cli.measured import hand_over, measured_or_read, read_measurement
from saver_advisors.reporting.errors import UsageError
from saver_advisors.reporting.provenance import machine_in_words
from saver_advisors.reporting.tables import Column
from saver_advisors.training.threads import one_thread_of_algebra
from saver_envs.files import read_json

EXAMPLES = """\
examples:
  python -m reproduction wrist-push --trials 200 --processes 2 --json result.json --table page.md
  python -m reproduction wrist-push --trials 20 --rows true-state-exact everything-learned
  python -m reproduction wrist-push --policy expert --injections 0
  python -m reproduction wrist-push --from rows.json faults.json --table page.md"""

#: Name of a row -> whether it uses camera and pose network, whether its kinematics are learned, and
#: its name on the page.
ROWS: Final[Mapping[str, tuple[bool, bool, str]]] = {
    "true-state-exact": (False, False, "true state, exact kinematics"),
    "true-state-learned": (False, True, "true state, learned kinematics"),
    "network-exact": (True, False, "pose network, exact kinematics"),
    "everything-learned": (True, True, "everything learned"),
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
    from reproduction.wrist_push.faults import FAULTS
    from reproduction.wrist_push.loop_trials import fault_row, play_row
    from saver_advisors.cli.run import settings_of

    base = settings_of(args)
    with shares(args.processes) as share:
        rows = []
        for name in args.rows:
            seeing, learned, _ = ROWS[name]
            settings = replace(base, seeing=seeing, learned_kinematics=learned)
            rows.append({"row": name, **play_row(share, settings, args.trials, args.seed)})
        faults = [
            fault_row(share, base, fault, args.injections, args.seed)
            for fault in (FAULTS if args.injections else ())
        ]
    return {
        "title": "Wrist push",
        "kind": "wrist-push",
        "trials": args.trials,
        "seed": args.seed,
        "processes": args.processes,
        "settings": base.to_mapping(),
        "rows": rows,
        "faults": faults,
    }


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
        for name in ("limits", "filter", "latencies", "seed"):
            if {**one, **one["settings"]}[name] != {**first, **first["settings"]}[name]:
                raise UsageError(f"argument --from: the files differ in {name}")
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


def _words(row: Mapping[str, Any]) -> str:
    """Name a row, with its policy if that is not the table's."""
    words = ROWS[row["row"]][-1] if row["row"] in ROWS else row["row"]
    return f"{words}, policy `{row['policy']}`" if "policy" in row else words


def _spread(values: Sequence[float] | None) -> str:
    return "-" if values is None else f"{values[0]:.0f}, {values[1]:.0f}"


OUTCOME_COLUMNS: Final[Mapping[str, Column]] = {
    "loop": _words,
    "trials": "{trials}",
    "succeeded": "{succeeded}",
    "rate": lambda one: f"{one['succeeded'] / one['trials']:.2f}",
    "95% interval": lambda one: "{:.2f} to {:.2f}".format(*one["ci95"]) if "ci95" in one else "-",
    "failed in reaching": "{failed_reaching}",
    "failed in pushing": "{failed_pushing}",
    "harmed": "{harmed}",
}
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
STAGE_COLUMNS: Final[Mapping[str, Column]] = {
    "stage": "{name}",
    "rate (Hz)": "{rate_hz:.1f}",
    "median (ms)": "{median_ms:.3f}",
    "95% (ms)": "{p95_ms:.3f}",
    "simulated latency (ms)": lambda one: (
        one["latency"] if isinstance(one["latency"], str) else f"{1000 * one['latency']:g}"
    ),
}


def render(figures: Mapping[str, Any]) -> str:
    """Render the figures as a page.

    :param figures: what was measured, or the content of its JSON file.
    :return: Markdown.
    """
    paper = {"row": "paper, on real arms", "harmed": "-", **read_json(PAPER)}
    latencies = figures["settings"]["latencies"]
    none: dict[str, Any] = {"stages": {}}
    fullest = max(figures["rows"], key=lambda row: len(row["stages"]), default=none)
    return page(
        "wrist-push",
        outcomes=[*figures["rows"], paper],
        fullest=fullest,
        stages=[
            {"name": name, "latency": latencies.get(name, 0.0), **one}
            for name, one in fullest["stages"].items()
        ],
        origins=figures.get("sources") or [figures["provenance"]],
        of_outcomes=OUTCOME_COLUMNS,
        of_faults=FAULT_COLUMNS,
        of_speeds=SPEED_COLUMNS,
        of_stages=STAGE_COLUMNS,
        words=_words,
        stops=_stops,
        machine=machine_in_words,
        **figures,
    )


def _stops(row: Mapping[str, Any]) -> str:
    """List what stopped the arms most often."""
    stops = Counter(
        stop.split("stopped", 1)[1].strip() for trial in row["outcomes"] for stop in trial["stops"]
    )
    return "; ".join(f"{words} ({count})" for words, count in stops.most_common(4))
