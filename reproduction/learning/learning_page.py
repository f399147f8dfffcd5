"""Render the figures of ``python -m reproduction learning`` as a page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from reproduction.page_parts import measured_at
from saver_advisors.reporting.tables import join_parts, markdown, rows_table

INTRODUCTION: Final = """\
Generated from the JSON file of `python -m reproduction learning`. A block is one episode in each
environment and the gradient steps after it. Times are processor time on one core. Compared loops
were measured alternately, block by block: figures are medians over the blocks, ratios medians of
the blocks' ratios. The effect of a change on the success rate is not measured here; success against
steps and minutes, ours and SB3's, is [beside the baselines](benchmark-td3-her.md).
"""

VARIANTS: Final = """\
One change at a time, and SB3's own algorithms with its hindsight replay, with the same widths,
batches and updates per block. Speed-ups are relative to the first row.
"""

VARIANT_COLUMNS: Final = {
    "learner": "{name}",
    "ms per update": "{update_ms:.1f}",
    "speed-up per update": "{times_as_fast_an_update:.2f}x",
    "steps per second": "{steps_per_second:,.0f}",
    "speed-up in all": "{times_as_fast:.2f}x",
}


def render(figures: Mapping[str, Any]) -> str:
    """Render the figures as a page.

    :param figures: what was measured, or the content of its JSON file.
    :return: Markdown.
    """
    parts = ["# Speed of learning", INTRODUCTION]
    for row in figures["rows"]:
        parts += [f"## {row['env']}", _settings(row), _parts(row), VARIANTS]
        parts.append(rows_table(row["variants"], VARIANT_COLUMNS))
        if "sbx" in row:
            parts.append(_sbx(row["sbx"]))
    return join_parts([*parts, _origin(figures)])


def _settings(row: Mapping[str, Any]) -> str:
    widths = " x ".join(str(width) for width in row["net_arch"])
    advice = f"advised by `{row['advice']}`" if row["advice"] else "without advice"
    return (
        f"{row['n_envs']} environments, {widths} units, batches of {row['batch_size']}, "
        f"{row['gradient_steps']} updates per block, {advice}."
    )


def _parts(row: Mapping[str, Any]) -> str:
    cells = [
        [name, f"{milliseconds:.0f}", f"{milliseconds / row['total']:.0%}"]
        for name, milliseconds in row["parts"].items()
    ]
    cells.append(["in all", f"{row['total']:.0f}", ""])
    return markdown(["part", "ms per 1,000 steps", "share"], cells)


def _sbx(row: Mapping[str, Any]) -> str:
    versions = ", ".join(f"{name} {version}" for name, version in row["versions"].items())
    return (
        f"SBX's TD3 ({versions}), compiled by XLA, with the same widths and batches: "
        f"{row['update_ms']:.1f} ms per update, {row['times_as_fast_an_update']:.2f} times as fast "
        "as ours beside it."
    )


def _origin(figures: Mapping[str, Any]) -> str:
    loads = " and ".join(
        str(one[0]) for one in (figures["load_before"], figures["load_after"]) if one
    )
    told = f" The system's load average was {loads} before and after." if loads else ""
    return f"Medians over {figures['rounds']} blocks.{told} {measured_at(figures)}".rstrip()
