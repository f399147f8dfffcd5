"""The figures of ``python -m reproduction learning`` as a page of Markdown."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from saver_advisors.reporting.provenance import machine_in_words
from saver_advisors.reporting.tables import markdown

INTRODUCTION: Final = """\
Rendered from the JSON file of `python -m reproduction learning`, never typed. A block is one
episode in each environment and the gradient steps after it. Processor time on one core; what is
compared was measured in turn, block by block: figures are medians over the blocks, ratios medians
of the blocks' ratios. What a change does to the success rate is not measured here; success against
steps and minutes, ours and SB3's, stands [beside the baselines](benchmark-td3-her.md).
"""

VARIANTS: Final = """\
One thing changed at a time, and SB3's own algorithms with its hindsight replay, with the same
widths, batches and updates a block. *Times as fast* is beside the first row, above 1 is faster.
"""


def render(figures: Mapping[str, Any]) -> str:
    """The figures as a page.

    :param figures: what the command measured, or its JSON file's content
    :return: Markdown
    """
    parts = ["# Speed of learning", INTRODUCTION]
    for row in figures["rows"]:
        parts += [f"## {row['env']}", _settings(row), _parts(row), VARIANTS, _variants(row)]
        if "sbx" in row:
            parts.append(_sbx(row["sbx"]))
    parts.append(_origin(figures))
    return "\n".join(part.rstrip("\n") + "\n" for part in parts)


def _settings(row: Mapping[str, Any]) -> str:
    widths = " x ".join(str(width) for width in row["net_arch"])
    advice = f"advised by `{row['advice']}`" if row["advice"] else "without advice"
    return (
        f"{row['n_envs']} environments, {widths} units, batches of {row['batch_size']}, "
        f"{row['gradient_steps']} updates a block, {advice}."
    )


def _parts(row: Mapping[str, Any]) -> str:
    cells = [
        [name, f"{milliseconds:.0f}", f"{milliseconds / row['total']:.0%}"]
        for name, milliseconds in row["parts"].items()
    ]
    cells.append(["in all", f"{row['total']:.0f}", ""])
    return markdown(["part", "ms a 1,000 steps", "share"], cells)


def _variants(row: Mapping[str, Any]) -> str:
    columns = [
        "learner",
        "ms an update",
        "times as fast an update",
        "steps per second",
        "times as fast in all",
    ]
    cells = [
        [
            one["name"],
            f"{one['update_ms']:.1f}",
            f"{one['times_as_fast_an_update']:.2f}x",
            f"{one['steps_per_second']:,.0f}",
            f"{one['times_as_fast']:.2f}x",
        ]
        for one in row["variants"]
    ]
    return markdown(columns, cells)


def _sbx(row: Mapping[str, Any]) -> str:
    versions = ", ".join(f"{name} {version}" for name, version in row["versions"].items())
    return (
        f"SBX's TD3 ({versions}), compiled by XLA, with the same widths and batches: "
        f"{row['update_ms']:.1f} ms an update, {row['times_as_fast_an_update']:.2f} times as fast "
        "as ours beside it."
    )


def _origin(figures: Mapping[str, Any]) -> str:
    loads = " and ".join(
        str(one[0]) for one in (figures["load_before"], figures["load_after"]) if one
    )
    told = f" The system's load average was {loads} before and after." if loads else ""
    origin = figures.get("provenance")
    if not origin:
        return f"Medians over {figures['rounds']} blocks.{told}"
    versions = origin["versions"]
    return (
        f"Medians over {figures['rounds']} blocks.{told} Measured {origin['time']} at commit "
        f"`{origin['commit']}` with `{origin['command']}` on "
        f"{machine_in_words(origin['machine'])}, PyTorch {versions['torch']}, Stable-Baselines3 "
        f"{versions['sb3']}."
    )
