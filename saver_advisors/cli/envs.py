"""List the registered environments, one row per id."""

from __future__ import annotations

import argparse

from saver_advisors.cli.arguments import add_flag, add_json, write_json

EXAMPLES = """\
examples:
  saver envs
  saver envs --all --json envs.json
  saver envs --markdown > table.md"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_flag(parser, "--all", "also list the variants with a dense reward")
    add_flag(parser, "--markdown", "print a Markdown table")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print the table."""
    from saver_advisors.cli.catalogue import COLUMNS, dense_twin, entry, pixel_ids, sparse_ids
    from saver_advisors.reporting import tables

    names = sparse_ids()
    listed = names + [dense_twin(name) for name in names] * args.all
    entries = [entry(name) for name in listed]
    if args.markdown:
        print(tables.rows_table(entries, COLUMNS), end="")
    else:
        tables.show_rows(entries, COLUMNS)
        if not args.all:
            print(f"Each id has a twin with a dense reward, such as {dense_twin(names[0])}.")
        for sentence in pixel_ids():
            print(sentence.replace("`", ""))
        print('Make one with gymnasium.make("saver_envs:' + names[0] + '").')
    write_json(args.json, {"environments": entries})
    return 0
