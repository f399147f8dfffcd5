"""Render the page of results from the JSON files in ``docs/results``."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from reproduction.page_templates import page
from saver_advisors.cli.curves import CURVE_COLUMNS
from saver_advisors.evaluation.protocol import environment_text
from saver_advisors.reporting.evaluation_table import COLLISIONS_COLUMN, EVALUATION_COLUMNS
from saver_advisors.reporting.provenance import machine_in_words
from saver_advisors.reporting.tables import markdown, rows_table
from saver_envs.files import read_json

FOLDER: Final = "results"
CURVES_FOLDER: Final = "results/learner"
"""Folders of result files, in that of the documentation."""

PAGES: Final = {
    "advising": "advising-results.md",
    "constraints": "constraints-results.md",
    "ecosystem": "ecosystem.md",
    "kinematics": "modelling-in-use.md",
    "learning": "learning-speed.md",
    "modelling-time": "modelling-time.md",
    "pose": "perception-results.md",
    "mujoco-warp": "scaling.md",
    "safe": "safe-baselines.md",
    "scaling": "scaling.md",
    "speed": "speed.md",
    "tracking": "modelling-tracking.md",
    "transfer": "transfer.md",
    "worlds": "worlds-results.md",
}
"""Pages of results, by the kind of the result file."""

SUCCESS_COLUMNS: Final = {**EVALUATION_COLUMNS, **COLLISIONS_COLUMN}
PAGES_OF_FILES: Final = {
    "fetch-id": "modelling-fetch-id.md",
    "fetch-ik": "modelling-fetch-ik.md",
    "mico-id": "modelling-mico-id.md",
    "mico-ik": "modelling-mico-ik.md",
    "mico-ik-little-data": "modelling-little-data.md",
}
"""Pages by file name, for kinds with several files."""


def read_result_files(folder: Path) -> list[dict[str, Any]]:
    """Read result files.

    :param folder: folder of the JSON files.
    :return: their contents with the name as ``file``, sorted by name.
    """
    return [{"file": path.name, **read_json(path)} for path in sorted(folder.glob("*.json"))]


def _evaluations(results: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [one for one in results if "success_rate" in one and "ci95" in one]


def results_of(env_id: str, results: list[dict[str, Any]]) -> str:
    """Render the evaluations on one environment.

    :param env_id: id of the environment.
    :param results: see :func:`read_result_files`.
    :return: a Markdown table; empty without evaluations.
    """
    found = [one for one in _evaluations(results) if one["env"] == env_id]
    return rows_table(found, SUCCESS_COLUMNS) if found else ""


def success_overview(results: list[dict[str, Any]], folder: str) -> str:
    """Compare the best shipped policy of each environment with teachers and scripted expert.

    :param results: see :func:`read_result_files`.
    :param folder: folder of the environments' pages, relative to the page that shows the table.
    :return: a Markdown table of the environments with a shipped policy.
    """
    from saver_advisors.pretrained import shipped_policies

    shipped = set(shipped_policies())
    places: dict[str, list[dict[str, Any]]] = {}
    for one in _evaluations(results):
        places.setdefault(environment_text(one["env"], one.get("env_kwargs") or {}), []).append(one)
    rows = []
    for place, found in places.items():
        ours = [one for one in found if one["policy"] in shipped]
        if not ours:
            continue
        best = max(ours, key=lambda one: one["success_rate"])
        teachers = [one for one in found if one["policy"].startswith("side-by-side:")]
        experts = [one for one in found if one["policy"] == "expert"]
        cells = [_success(one) for one in ([best], teachers, experts)]
        rows.append([f"[`{place}`]({folder}{best['env']}.md)", f"`{best['policy']}`", *cells])
    columns = ("environment", "policy", "success", "teachers side by side", "scripted expert")
    return markdown(columns, rows)


def _success(found: list[dict[str, Any]]) -> str:
    """Return a success rate with its 95% interval and number of episodes."""
    if not found:
        return "-"
    low, high = found[0]["ci95"]
    rate, episodes = found[0]["success_rate"], found[0]["episodes"]
    return f"{rate:.3f} [{low:.3f}, {high:.3f}] of {episodes}"


def results_page(results: list[dict[str, Any]]) -> str:
    """Render all results as tables.

    :param results: see :func:`read_result_files`.
    :return: Markdown.
    """
    evaluations = _evaluations(results)
    sections = [_section(one) for one in results if one not in evaluations]
    named = {"title": "Results", "folder": FOLDER, "introduction": ""}
    return page("results", **named, evaluations=evaluations, columns=SUCCESS_COLUMNS, sections=sections)


def curves_page(results: list[dict[str, Any]]) -> str:
    """Render the learning curves of the present learner.

    :param results: of ``CURVES_FOLDER``; see :func:`read_result_files`.
    :return: Markdown.
    """
    sections = [_section(one, CURVES_FOLDER) for one in results]
    introduction = (
        "Success rate, collisions and mean Q-value at each evaluation during training, of the "
        "student alone. Training time is wall-clock time, pauses included."
    )
    named = {"title": "Learning curves", "folder": CURVES_FOLDER, "introduction": introduction}
    return page("results", **named, evaluations=[], columns={}, sections=sections)


def _section(one: dict[str, Any], folder: str = FOLDER) -> dict[str, str]:
    stem = Path(one["file"]).stem
    text = ""
    if one.get("kind") == "curves":
        picture = f"![learning curves]({folder}/{stem}.png)\n\n"
        text = picture + rows_table(one["runs"], CURVE_COLUMNS)
    elif separate := PAGES_OF_FILES.get(stem) or PAGES.get(str(one.get("kind"))):
        text = f"See [the separate page]({separate})."
    elif one.get("kind") == "modelling-search":
        text = _plain_table(_trials(one["trials"]))
    elif isinstance(one.get("rows"), list):
        text = _plain_table(one["rows"])
    heading = one.get("title", stem.replace("-", " ").capitalize())
    return {"heading": heading, "text": text, "origin": _origin(one)}


def _trials(trials: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the trials of a search as flat rows, the best first."""
    measured = ("epochs", "validation_rmse")
    return [
        {**trial["settings"], **{name: trial[name] for name in measured if name in trial}}
        for trial in sorted(trials, key=lambda trial: float(trial["validation_rmse"]))
    ]


def _plain_table(rows: list[dict[str, Any]]) -> str:
    """Render rows of a result file with one column per key."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    cells = [[_cell(row.get(name)) for name in columns] for row in rows]
    return markdown([name.replace("_", " ") for name in columns], cells)


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"
    return str(value)


def _origin(one: dict[str, Any]) -> str:
    """Describe the origin of a result: command, commit and machine, if recorded."""
    source = one.get("provenance", one)
    parts = [f"`{source['command']}`"] if source.get("command") else []
    if source.get("commit"):
        parts.append(f"commit `{source['commit'][:12]}`")
    if machine := source.get("machine"):
        parts.append(machine_in_words(machine))
    return "; ".join(parts) + ("." if parts else "")
