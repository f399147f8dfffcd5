"""Render the text of the generated documentation.

Nothing here draws or simulates, so that a test can quickly compare the pages with the code.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Final

from reproduction.command_parts import between_markers
from reproduction.pages.environments import (
    environment_page,
    environments_page,
    environments_table,
)
from reproduction.pages.results import read_result_files, results_page, success_overview
from reproduction.pages.worlds import worlds_page
from saver_advisors.benchmark.pose.pose_page import pose_page
from saver_advisors.cli.catalogue import entry, sparse_ids
from saver_advisors.reporting.tables import markdown

GENERATED: Final = "Generated from the code by `python -m reproduction pages`.\n"


def all_pages(output: Path) -> dict[str, str]:
    """Render all generated pages.

    :param output: folder of the documentation; its ``results/*.json`` are read.
    :return: text by path within that folder.
    """
    results = read_result_files(output / "results")
    entries = [entry(name) for name in sparse_ids()]
    pages = {f"environments/{one['env_id']}.md": environment_page(one, results) for one in entries}
    pages["environments/index.md"] = environments_page(entries) + GENERATED
    pages["worlds.md"] = worlds_page(sparse_ids()) + GENERATED
    pages["weights.md"] = weights_page() + GENERATED
    pages["results.md"] = f"{results_page(results)} {GENERATED}"
    pose = output / "results" / "pose.json"
    if pose.is_file():
        pages["perception-results.md"] = pose_page(json.loads(pose.read_text(encoding="utf-8")))
    return pages


def with_tables(readme: str, output: Path) -> str:
    """Insert the tables of environments and of success rates between the README's markers.

    :param readme: text of the README.
    :param output: folder of the documentation, next to the README; its ``results/*.json`` are read.
    :return: the new text.
    :raises ValueError: if a marker is missing.
    """
    entries = [entry(name) for name in sparse_ids()]
    folder = f"{output.name}/environments/"
    tables = {
        "envs": environments_table(entries, folder),
        "success": success_overview(read_result_files(output / "results"), folder),
    }
    for name, table in tables.items():
        readme = between_markers(readme, f"<!-- {name}:begin -->", f"<!-- {name}:end -->", table)
    return readme


def weights_page() -> str:
    """Render the cards of the shipped policies."""
    from saver_advisors.policies import WEIGHTS_DIR, shipped_policies
    from saver_advisors.policies.cards import rate_text
    from saver_advisors.policies.files import read_networks

    cards = {
        name: read_networks(WEIGHTS_DIR / f"{name}.safetensors")[1] for name in shipped_policies()
    }
    rows = [
        [
            f"`{name}`",
            f"[`{card.environment}`](environments/{card.env_id}.md)",
            card.algorithm,
            f"{card.steps:,}",
            f"{card.wall_clock_s / 60:.0f}",
            f"{card.success:.3f} of {card.success_episodes}",
            rate_text(card.safe_success),
            rate_text(card.success_2cm),
        ]
        for name, card in cards.items()
    ]
    columns = (
        *("name", "environment", "algorithm", "steps", "minutes", "success, episodes"),
        *("safe", "within 2 cm"),
    )
    lines = ["# Weights", "", markdown(columns, rows)]
    lines += [
        "Each file has a card with its command, seed, commit and settings:",
        '`saver_advisors.pretrained.load_policy("' + (next(iter(cards), "NAME")) + '").card`.',
        "The success rate of a card is measured on seeds from 0, in episodes that were not used to",
        "choose the checkpoint; so are the success without a collision and that within 2 cm.",
        "",
    ]
    for name, card in cards.items():
        lines += [f"## {name}", "", "```", card.command, "```", ""]
        if training := card.notes.get("training"):
            lines += [f"Training: {training}.", ""]
    return "\n".join([*lines, ""])
