"""Plot the learning curves of training runs, and list the steps to a success rate of 0.9.

"Steps to 0.9" is the first evaluation with at least that success rate. Mean Q is the student's
estimate in the states of its evaluation episodes. Wall-clock time excludes evaluations.
"""

from __future__ import annotations

import argparse

from saver_advisors.cli.arguments import add_figure, add_json, add_path, write_json

EXAMPLES = """\
examples:
  saver curves runs/push --output push.png
  saver curves runs/dual runs/alone --output advice.png --json advice.json"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_path(parser, "run_dirs", "of `saver train`", metavar="RUN_DIR", nargs="+")
    add_figure(parser, "--output", "draw the figure there")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print the table, draw the figure, write the figures."""
    from saver_advisors.cli.runs import CURVE_COLUMNS, draw, read_runs, summary
    from saver_advisors.evaluation.metrics import SOLVED
    from saver_advisors.reporting.tables import show_rows

    runs = read_runs(args.run_dirs)
    summaries = [summary(one) for one in runs]
    show_rows(summaries, CURVE_COLUMNS)
    if args.output is not None:
        draw(runs).savefig(args.output)
        print(f"wrote {args.output}")
    write_json(args.json, {"kind": "curves", "solved_at": SOLVED, "runs": summaries})
    return 0
