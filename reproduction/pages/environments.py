"""Render the page of each environment, and the page that lists them all."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from typing import Any

from reproduction.joint_speeds import measured_row
from reproduction.page_templates import page
from reproduction.pages.results import results_of
from saver_advisors.cli.catalogue import COLUMNS, dense_twin, pixel_ids
from saver_advisors.reporting.tables import markdown, rows_table
from saver_envs.digest import world_digest
from saver_envs.registration import ControlOptions, default_options, make_episodes
from saver_envs.simulation import ACTION_DURATION
from saver_envs.tasks.contract import Task
from saver_envs.tasks.layout import Layout, Part


def environments_table(entries: list[dict[str, Any]], folder: str) -> str:
    """Render the table of environments with links to their pages.

    :param entries: the rows.
    :param folder: folder of the pages, relative to the page that shows the table.
    :return: Markdown.
    """
    columns = {**COLUMNS, "id": f"[`{{env_id}}`]({folder}{{env_id}}.md)"}
    return rows_table(entries, columns)


def environments_page(entries: list[dict[str, Any]]) -> str:
    """Render the page that lists the environments.

    :param entries: the rows of its table.
    :return: Markdown.
    """
    return page(
        "environments",
        table=environments_table(entries, ""),
        twin=dense_twin(entries[0]["env_id"]),
        pixels=pixel_ids(),
    )


def environment_page(one: Mapping[str, Any], results: list[dict[str, Any]]) -> str:
    """Render the page of an id and its twin with a dense reward.

    :param one: entry of the sparse id.
    :param results: result files, see :func:`~reproduction.pages.results.read_result_files`.
    :return: Markdown.
    """
    episodes = make_episodes(one["env_id"])
    task = episodes.task
    told = task.page(episodes.scene)
    return page(
        "environment",
        told=told,
        entry=one,
        summary=_one_line(inspect.getdoc(inspect.getmodule(type(task))) or ""),
        twin=dense_twin(one["env_id"]),
        duration=ACTION_DURATION,
        max_speed=episodes.settings.max_speed,
        speeds=measured_row(one["env_id"], results),
        observation=_layout_table(task.observation_layout, _unit),
        indices=_indices,
        action_size=episodes.action_size_per_arm,
        held_height=task.held_height,
        goal=_layout_table(task.goal_layout, lambda part: part.unit, told.goal),
        can_be_lost=task.keeps_to_table and len(episodes.scene.loose_qpos) > 0,
        keywords=_keywords(one["env_id"], task),
        world=world_digest(one["env_id"]),
        results=results_of(one["env_id"], results),
    )


def _layout_table(
    layout: Layout, unit: Callable[[Part], str], meanings: Mapping[str, str] | None = None
) -> str:
    """Render one row per part: its indices, meaning and unit."""
    rows, own, common = [], 0, layout.block * layout.n_arms
    for part in layout.parts:
        if part.shared:
            place = _indices(common, part.size, 0, 1)
            common += part.size
        else:
            place = _indices(own, part.size, layout.block, layout.n_arms)
            own += part.size
        rows.append([place, (meanings or {}).get(part.name, part.name), unit(part)])
    return markdown(("index", "what", "unit"), rows)


def _unit(part: Part) -> str:
    return part.unit if part.scale == 1 else f"{part.unit} x {part.scale}"


def _indices(first: int, size: int, block: int, arms: int) -> str:
    """Return ``3 to 5``, or ``28k + 3 to 28k + 5`` if each arm has its own block."""
    ends = [first] if size == 1 else [first, first + size - 1]
    offset = f"{block}k + " if arms > 1 else ""
    return " to ".join(f"{offset}{end}" for end in ends)


def _keywords(env_id: str, task: Task) -> str:
    """Render the keyword arguments of an id, as its task and control document them."""
    meanings: dict[str, str] = {}
    for kind in (*reversed(type(task).__mro__), ControlOptions):
        meanings |= parameters(inspect.getdoc(kind) or "")
    rows = [
        [f"`{name}`", f"`{default!r}`", meanings[name].replace("``", "`")]
        for name, default in default_options(env_id).items()
    ]
    return markdown(("name", "default", "meaning"), rows)


def parameters(docstring: str) -> dict[str, str]:
    """Extract the descriptions of parameters from a docstring.

    :param docstring: with ``:param name: text`` entries, each on one or more lines.
    :return: the descriptions by name.
    """
    entries = re.findall(r":param (\w+): (.*?)(?=\n:|\n\n|\Z)", docstring, flags=re.DOTALL)
    return {name: _one_line(text) for name, text in entries}


def _one_line(text: str) -> str:
    return " ".join(text.split())
