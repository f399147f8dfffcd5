"""Render the page about worlds that vary, and draw its pictures."""

from __future__ import annotations

from contextlib import suppress
from typing import Final

import numpy as np
from numpy.typing import NDArray

from reproduction.page_templates import page
from saver_advisors.reporting.tables import Column, rows_table
from saver_envs.episodes import Episodes
from saver_envs.randomization import Choice, LogUniform, Parameter
from saver_envs.randomization.distributions import Distribution
from saver_envs.randomization.parameters import COMMON
from saver_envs.registration import ENVIRONMENTS, make_episodes, task_and_settings
from saver_envs.sensor_errors import SENSORS
from saver_envs.simulation import SLOWEST_DRY
from saver_envs.tasks.contract import NoStart

#: Most whole numbers that a table lists.
MOST_VALUES: Final = 4
#: Ids whose worlds are drawn.
SHOWN: Final = ("DualJacoPickAndPlace-v0", "WristPush-v0")
#: Draws in a strip, and how many are side by side.
DRAWS, COLUMNS = 10, 5
PICTURE_SIZE: Final = (640, 480)
#: What is kept of a picture: the left, upper, right and lower edge, pixels.
KEPT: Final = (170, 170, 490, 410)


def worlds_page(sparse_ids: list[str]) -> str:
    """Render the page.

    :param sparse_ids: the ids whose tasks it describes.
    :return: Markdown.
    """
    task, _ = task_and_settings(sparse_ids[0], {})
    return page(
        "worlds",
        tasks=_tables_of_tasks(sparse_ids),
        common=_table(COMMON),
        sensors=_sensors(sparse_ids),
        shown=SHOWN,
        draws=DRAWS,
        horizon=task.horizon,
        rated_horizon=task.rated_horizon,
        slowest_dry=SLOWEST_DRY,
    )


def _tables_of_tasks(sparse_ids: list[str]) -> list[tuple[str, str]]:
    """Render a table for each set of parameters, headed by the ids whose tasks have it."""
    ids: dict[tuple[Parameter, ...], list[str]] = {}
    for env_id in sparse_ids:
        ids.setdefault(ENVIRONMENTS[env_id].task.parameters, []).append(env_id)
    return [
        (", ".join(f"`{env_id}`" for env_id in found), _table(parameters))
        for parameters, found in ids.items()
        if parameters
    ]


def _table(parameters: tuple[Parameter, ...]) -> str:
    columns: dict[str, Column] = {
        "name": lambda one: f"`{one.name}`",
        "what": lambda one: f"{one.text}{_numbers(one)}",
        "unit": lambda one: one.unit,
        "nominal": _nominal,
        "`wide`": lambda one: distribution_text(one.wide),
        "`mild`": lambda one: distribution_text(one.mild),
        "held out": lambda one: distribution_text(one.held_out),
        "limits": lambda one: ", ".join(one.names) or f"{one.limits[0]:g} to {one.limits[1]:g}",
    }
    return rows_table(parameters, columns)


def _nominal(one: Parameter) -> str:
    """Return the nominal value of a parameter, a name where its values have names."""
    if one.nominal is None:
        return "drawn"
    return one.usual if isinstance(one.usual, str) else f"{one.nominal:g}"


def _numbers(one: Parameter) -> str:
    """Say how many numbers a parameter has, if it has several."""
    if one.size == 1:
        return ""
    return f"; {one.size} numbers{' for each arm' if one.per_arm else ''}"


def distribution_text(distribution: Distribution | None) -> str:
    """Describe a distribution in a few words; nothing without one."""
    if distribution is None:
        return ""
    low, high = distribution.ends
    if isinstance(distribution, Choice):
        if distribution.whole and len(distribution.values) > MOST_VALUES:
            return f"{low:g} to {high:g}, whole"
        parts = [
            f"{value:g}" if isinstance(value, int | float) else distribution_text(value)
            for value in distribution.values
        ]
        separator = ", " if all("to" not in part for part in parts) else " or "
        return separator.join(parts)
    scale = ", log" if isinstance(distribution, LogUniform) else ""
    return f"{low:.3g} to {high:.3g}{scale}"


def _sensors(sparse_ids: list[str]) -> str:
    tasks = [task_and_settings(env_id, {})[0] for env_id in sparse_ids]
    units = {part.name: part.unit for task in tasks for part in task.observation}
    columns: dict[str, Column] = {
        "part": lambda one: one.part,
        # An orientation is turned by its error.
        "unit": lambda one: "rad" if units[one.part] == "1" else units[one.part],
        "at every step": lambda one: f"{one.deviation:g}",
        "for an episode": lambda one: f"{one.offset:g}" if one.offset else "",
    }
    return rows_table(SENSORS, columns)


def world_pictures(env_id: str) -> NDArray[np.uint8]:
    """Draw starts from the same seed in several worlds of the preset ``wide``.

    :param env_id: a registered id.
    :return: (height, width, 3), the pictures in rows.
    """
    from saver_envs.cameras.rendering import SceneRenderer

    episodes = make_episodes(env_id, DRAWS, randomization="wide")
    for row in range(DRAWS):
        episodes.set_generator(row, np.random.default_rng(row))
    episodes.reset()
    renderer = SceneRenderer(episodes.scene, *PICTURE_SIZE)
    left, upper, right, lower = KEPT
    pictures = []
    for row in range(DRAWS):
        _start_from_seed_0(episodes, row)
        renderer.update(episodes, row)
        pictures.append(renderer.rgb()[upper:lower, left:right].copy())
    renderer.close()
    lines = [pictures[first : first + COLUMNS] for first in range(0, DRAWS, COLUMNS)]
    return np.concatenate([np.concatenate(line, axis=1) for line in lines], axis=0)


def _start_from_seed_0(episodes: Episodes, row: int) -> None:
    """Place an episode at the first start that seed 0 gives in its world."""
    generator, task = np.random.default_rng(0), episodes.worlds.tasks[row]
    while True:
        with suppress(NoStart):
            start = task.sample(generator, episodes.scene)
            break
    task.place(episodes.simulation, episodes.memory, np.array([row]), [start])
    episodes.goal[row] = task.desired([start])[0]
