"""Render the figures of ``saver benchmark speed`` as a page of Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from saver_advisors.benchmark.speed.randomized_steps import MUST
from saver_advisors.reporting.provenance import measured_at
from saver_advisors.reporting.tables import (
    Column,
    markdown,
    optional,
    row_cells,
    rows_table,
)
from saver_advisors.reporting.templates import rendered

#: Columns of the table of steps: heading, and the format of a row's figure.
_STEPS: Final[Sequence[tuple[str, Column]]] = (
    ("environment", "{env}"),
    ("n_envs", "{n_envs}"),
    ("threads", "{threads}"),
    ("raw", "{raw_steps_per_second:,.0f}"),
    ("Gymnasium", "{steps_per_second:,.0f}"),
    ("ratio", "{ratio_to_raw:.2f}"),
    ("core", "{core_steps_per_second:,.0f}"),
    ("ratio", "{core_ratio_to_raw:.2f}"),
    ("SB3", "{sb3_steps_per_second:,.0f}"),
    ("ratio", "{sb3_ratio_to_raw:.2f}"),
    ("threads' gain", "{speed_up_of_threads:.2f}x"),
    ("MB an environment", optional("memory_per_env_mb")),
)
_COLUMNS: Final[Mapping[str, Mapping[str, Column]]] = {
    "ratios": {
        "environment": "{env}",
        "peer": "{peer}",
        "times as fast": "{ratio:.1f}x",
        "must": lambda row: _bar(row["must"]),
        "aim": lambda row: _bar(row["aim"]),
    },
    "rates": {
        "environment": "{env}",
        "suite": "{suite}",
        "mode": "{mode}",
        "n_envs": "{n_envs}",
        "steps per second": "{steps_per_second:,.0f}",
        "versions": lambda row: ", ".join(f"{name} {one}" for name, one in row["versions"].items()),
    },
    "advice": {
        "strategy": "{strategy}",
        "environment": "{env}",
        "advised at once": "{n_envs} x {arms} arms",
        "ms": "{milliseconds:.2f}",
        "share of the step's time": "{share_of_step:.1%}",
    },
}


def render(figures: Mapping[str, Any]) -> str:
    """Render the figures as a page.

    :param figures: what ``saver benchmark speed`` measured, or its JSON file's content
    :return: Markdown
    """
    peers, randomized = figures.get("peers"), figures.get("randomized")
    ours = {"suite": "SAVER", "mode": "gymnasium vector", "versions": {}}
    headings, columns = zip(*_STEPS, strict=True)
    loads = (figures.get("load_average") or {}).items()
    return rendered(
        "saver_advisors.benchmark",
        "speed.md.j2",
        columns=_COLUMNS,
        peers=peers,
        rates=[*({**ours, **one} for one in peers["ours"]), *peers["peers"]] if peers else [],
        steps=markdown(headings, row_cells(figures["rows"], columns)),
        randomized=_randomized(randomized) if randomized else "",
        resets=_resets(figures["resets"]),
        **{name: figures[name] for name in ("replay", "advice", "rounds")},
        loads=[f"{when} {one[0]:g}" for when, one in loads if one],
        measured=measured_at(figures, {"Python": "python", "MuJoCo": "mujoco"}),
    )


def _bar(times: float | None) -> str:
    return "-" if times is None else f"{times:g}x"


def _randomized(rows: Sequence[Mapping[str, Any]]) -> str:
    def memory(row: Mapping[str, Any]) -> str:
        default, wide = (row["memory_per_env_mb"][name] for name in ("default", "wide"))
        return f"{wide / default:.2f}x" if default and wide else "-"

    columns: dict[str, Column] = {
        "environment": "{env}",
        "n_envs": "{n_envs}",
        "default": "{steps_per_second:,.0f}",
        f"nominal (at least {MUST['nominal']:g})": "{nominal:.2f}",
        "identical": lambda row: "yes" if row["identical"] else "no",
        f"wide (at least {MUST['wide']:g})": "{wide:.2f}",
        "raw": "{raw_steps_per_second:,.0f}",
        f"wide of raw (at least {MUST['wide_to_raw']:g})": "{wide_to_raw:.2f}",
        f"reset (at most {MUST['reset']:g}x)": "{reset:.2f}x",
        f"memory (at most {MUST['memory']:g}x)": memory,
    }
    return rows_table(rows, columns)


def _resets(resets: Sequence[Mapping[str, Any]]) -> str:
    counts = list(resets[0]["milliseconds_per_episode"]) if resets else []
    columns = ["environment", *(f"ms an episode, {count} at once" for count in counts)]
    rows = [
        [one["env"], *(f"{one['milliseconds_per_episode'][count]:.2f}" for count in counts)]
        for one in resets
    ]
    return markdown(columns, rows)
