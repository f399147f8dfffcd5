"""The whole robot over many trials, part by part, and with faults, beside chapter 8's table.

Four loops play the same trials: with the true state or the camera and the pose network, with exact
or learned inverse kinematics. Then every fault is injected into the loop with everything learned.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from saver_advisors.cli.measured import hand_over, read_measurement
from saver_advisors.training.threads import one_thread_of_algebra

if TYPE_CHECKING:
    from saver_advisors.integration.assembly import LoopSettings

EXAMPLES = """\
examples:
  python -m reproduction wrist-push --trials 200 --processes 2 --json result.json --table page.md
  python -m reproduction wrist-push --trials 20 --rows true-state-exact everything-learned
  python -m reproduction wrist-push --policy expert --injections 0
  python -m reproduction wrist-push --from rows.json faults.json --table page.md"""

#: Name of a row -> whether it sees by camera and network, and whether its kinematics are learned.
ROWS: Final[Mapping[str, tuple[bool, bool]]] = {
    "true-state-exact": (False, False),
    "true-state-learned": (False, True),
    "network-exact": (True, False),
    "everything-learned": (True, True),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    from saver_advisors.cli.arguments import add_json, add_table, at_least
    from saver_advisors.cli.run import add_loop_arguments

    parser.add_argument(
        "--trials", type=at_least(1), default=200, metavar="N", help="of each row (default: 200)"
    )
    parser.add_argument(
        "--seed", type=at_least(0), default=0, metavar="S", help="of trial 0 (default: 0)"
    )
    parser.add_argument(
        "--rows",
        nargs="*",
        choices=tuple(ROWS),
        default=list(ROWS),
        help="which; none leaves that table out (default: all)",
    )
    parser.add_argument(
        "--injections",
        type=at_least(0),
        default=20,
        metavar="N",
        help="of each fault; 0 leaves that table out (default: 20)",
    )
    parser.add_argument(
        "--processes", type=at_least(1), default=1, metavar="N", help="that share the trials"
    )
    add_loop_arguments(parser)
    add_table(parser)
    parser.add_argument(
        "--from",
        dest="from_json",
        nargs="+",
        type=Path,
        metavar="FILE",
        help="show earlier measurements' JSON files instead of measuring; what was measured apart "
        "comes into one table",
    )
    add_json(parser)


@one_thread_of_algebra()
def run(args: argparse.Namespace) -> int:
    """Measure, show, and write where asked for.

    :param args: see :func:`add_arguments`
    :return: exit status
    """
    from reproduction.wrist_push.wrist_push_page import render
    from saver_advisors.reporting.provenance import provenance

    if args.from_json is None:
        origin = provenance()
        figures = {**measure(args), "provenance": origin}
    else:
        figures = joined([read_measurement(path, "wrist-push") for path in args.from_json])
    page = render(figures)
    hand_over(page, figures, args.json, args.table)
    return 0


def measure(args: argparse.Namespace) -> dict[str, Any]:
    """Play every row's trials, and inject every fault.

    :param args: see :func:`add_arguments`
    :return: JSON-able: ``rows``, ``faults``, and what was asked for
    """
    from dataclasses import replace

    from reproduction.wrist_push.trials import fault_row, play_row, shares
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
            settings: LoopSettings = replace(base, seeing=seeing, learned_kinematics=learned)
            figures["rows"].append(
                {"row": name, **play_row(share, settings, args.trials, args.seed)}
            )
        for fault in FAULTS if args.injections else ():
            figures["faults"].append(fault_row(share, base, fault, args.injections, args.seed))
    return figures


def joined(measured: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Measurements that were made apart as one.

    :param measured: each with its own origin; all with the same settings, the policy apart
    :return: rows and faults of all; a row whose policy is not the first's tells it
    :raises UsageError: for other settings, another first seed, or a row that is there twice
    """
    from saver_advisors.reporting.errors import UsageError

    first = measured[0]
    if len(measured) == 1:
        return first
    rows, faults = [], []
    for one in measured:
        policy = one["settings"]["policy"]
        for name in ("limits", "filter", "latencies"):
            if one["settings"][name] != first["settings"][name]:
                raise UsageError(f"argument --from: measured with other {name}: no one table")
        if one["seed"] != first["seed"]:
            raise UsageError(
                f"argument --from: trials from seed {one['seed']} and from {first['seed']}: no one "
                "table"
            )
        told = {} if policy == first["settings"]["policy"] else {"policy": policy}
        rows += [{**row, **told} for row in one["rows"]]
        faults += one["faults"]
    names = [(row["row"], row.get("policy")) for row in rows]
    for name, policy in names:
        if names.count((name, policy)) > 1:
            raise UsageError(f"argument --from: row {name!r} is there twice: no one table")
    origins = [one["provenance"] for one in measured]
    rows.sort(key=lambda row: ("policy" in row, list(ROWS).index(row["row"])))
    return {**first, "rows": rows, "faults": faults, "sources": origins}
