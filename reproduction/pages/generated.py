"""Render the text of the generated documentation.

Nothing here draws or simulates, so that a test can quickly compare the pages with the code.
"""

from __future__ import annotations

from pathlib import Path

from reproduction.command_parts import between_markers
from reproduction.page_templates import page
from reproduction.pages.environments import (
    environment_page,
    environments_page,
    environments_table,
)
from reproduction.pages.gallery import gallery_page
from reproduction.pages.leaderboard import leaderboard_page
from reproduction.pages.limp_person import limp_person_page
from reproduction.pages.notebooks import FOLDER, TUTORIALS, notebook
from reproduction.pages.results import (
    CURVES_FOLDER,
    curves_page,
    read_result_files,
    results_page,
    success_overview,
)
from reproduction.pages.scaling import scaling_page
from reproduction.pages.worlds import worlds_page
from saver_advisors.benchmark.pose.pose_page import pose_page
from saver_advisors.cli.catalogue import entry, sparse_ids
from saver_advisors.reporting.errors import user_mistakes
from saver_advisors.reporting.tables import Column
from saver_envs.files import read_json


def all_pages(output: Path, readme: Path | None) -> dict[Path, str]:
    """Render all generated pages and notebooks, and insert tables between the README's markers.

    :param output: folder of the documentation; its ``results/*.json`` are read, the clips in
        ``images`` are listed, and the tutorials that are there become notebooks.
    :param readme: the README next to that folder; None to leave it out.
    :return: text by path.
    :raises UsageError: if the README cannot be read or lacks a marker.
    """
    results = read_result_files(output / "results")
    entries = [entry(name) for name in sparse_ids()]
    pages = {f"environments/{one['env_id']}.md": environment_page(one, results) for one in entries}
    pages["environments/index.md"] = environments_page(entries)
    pages["limp-person.md"] = limp_person_page()
    pages["worlds.md"] = worlds_page(sparse_ids())
    pages["gallery.md"] = gallery_page(output / "images", sparse_ids())
    pages["weights.md"] = weights_page()
    pages["results.md"] = results_page(results)
    pages["learning-curves.md"] = curves_page(read_result_files(output / CURVES_FOLDER))
    pages["leaderboard.md"] = leaderboard_page(output / "results")
    pose = output / "results" / "pose.json"
    if pose.is_file():
        pages["perception-results.md"] = pose_page(read_json(pose))
    if (text := scaling_page(output / "results")) is not None:
        pages["scaling.md"] = text
    tutorials = [page for name in TUTORIALS if (page := output / f"{name}.md").is_file()]
    pages |= {f"{FOLDER}/{page.stem}.ipynb": notebook(page) for page in tutorials}
    texts = {output / name: text for name, text in pages.items()}
    if readme is not None:
        folder = f"{output.name}/environments/"
        envs, success = environments_table(entries, folder), success_overview(results, folder)
        with user_mistakes("argument --readme"):
            text = readme.read_text(encoding="utf-8")
            text = between_markers(text, "<!-- envs:begin -->", "<!-- envs:end -->", envs)
            texts[readme] = between_markers(
                text, "<!-- success:begin -->", "<!-- success:end -->", success
            )
    return texts


def weights_page() -> str:
    """Render the cards of the shipped policies."""
    from saver_advisors.policies.cards import rate_text
    from saver_advisors.policies.files import WEIGHTS_DIR, read_networks, shipped_policies

    rows = [
        {"name": name, "card": read_networks(WEIGHTS_DIR / f"{name}.safetensors")[1]}
        for name in shipped_policies()
    ]
    columns: dict[str, Column] = {
        "name": "`{name}`",
        "environment": "[`{card.environment}`](environments/{card.env_id}.md)",
        "algorithm": "{card.algorithm}",
        "steps": "{card.steps:,}",
        "minutes": lambda row: f"{row['card'].wall_clock_s / 60:.0f}",
        "success, episodes": "{card.success:.3f} of {card.success_episodes}",
        "safe": lambda row: rate_text(row["card"].safe_success),
        "within 2 cm": lambda row: rate_text(row["card"].success_2cm),
    }
    return page("weights", rows=rows, columns=columns)
