"""Render the figures of ``saver benchmark scaling`` as tables of Markdown."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from saver_advisors.reporting.provenance import measured_at
from saver_advisors.reporting.tables import Column, rows_table

ROW_COLUMNS: Final[Mapping[str, Column]] = {
    "on": "{backend}",
    "workers": "{workers}",
    "runs": "{runs}",
    "runs an hour": "{runs_per_hour:.0f}",
    "efficiency": "{efficiency:.0%}",
    "speed of the processor": "{processor_speed:.0%}",
    "submitted to first step (s)": "{placing_s:.1f}",
    "of these, process to first step (s)": "{starting_s:.1f}",
    "training (s)": "{training_s:.1f}",
    "its processor time (s)": "{training_processor_s:.1f}",
    "whole process (s)": "{process_s:.1f}",
    "worker without a process, per run (s)": "{idle_s:.1f}",
}
CHECKPOINT_COLUMNS: Final[Mapping[str, Column]] = {
    "environment": "{env}",
    "transitions": "{transitions:,}",
    "MB": "{megabytes:.0f}",
    "writing (s)": "{writing_s:.2f}",
    "reading (s)": "{reading_s:.2f}",
    "every so many steps": "{every_steps:,}",
}


def tables(figures: Mapping[str, Any]) -> dict[str, str]:
    """Render the tables of the figures.

    :param figures: what ``saver benchmark scaling`` measured, or its JSON file's content
    :return: ``rows`` and ``checkpoint``
    """
    return {
        "rows": rows_table(figures["rows"], ROW_COLUMNS),
        "checkpoint": rows_table([figures["checkpoint"]], CHECKPOINT_COLUMNS),
    }


def loads_of(figures: Mapping[str, Any]) -> str:
    """Say how busy the machine was, and how many processors it has."""
    before, after = (figures["load_average"][when] for when in ("before", "after"))
    cores = figures["hardware_threads"]
    text = f"The machine has {cores} hardware threads"
    if before and after:
        text += f", and its load average was {before[0]:g} before and {after[0]:g} after"
    return f"{text}."


def render(figures: Mapping[str, Any]) -> str:
    """Render the figures as a page.

    :param figures: what ``saver benchmark scaling`` measured, or its JSON file's content
    :return: Markdown
    """
    shown = tables(figures)
    return (
        f"# {figures['title']}\n\n"
        f"{figures['env']}, {figures['steps']:,} steps per run. {loads_of(figures)}\n\n"
        f"{shown['rows']}\n"
        f"A process that resumes a run needs {figures['resuming_s']:.1f} s to its first step. "
        f"A checkpoint with a full replay:\n\n{shown['checkpoint']}\n{measured_at(figures)}\n"
    )
