"""Render the demo's page: one HTML file with all pictures and videos embedded."""

from __future__ import annotations

import argparse
import base64
import io
from pathlib import Path
from typing import Any, Final

import numpy as np

from saver_advisors.cli.curves import CURVE_COLUMNS, PANELS, draw
from saver_advisors.evaluation.protocol import environment_text
from saver_advisors.experiments.training_runs import drawn_run
from saver_advisors.reporting.curve_style import COLOURS
from saver_advisors.reporting.evaluation_table import COLLISIONS_COLUMN, EVALUATION_COLUMNS
from saver_advisors.reporting.tables import row_cells
from saver_advisors.reporting.templates import rendered
from saver_envs.registration import ONE_ARM_ID

PICTURE_WIDTH: Final = 480
ROBOT_VIDEO: Final = "whole-robot.mp4"


def render(args: argparse.Namespace, figures: dict[str, Any], **parts: Any) -> str:
    """Render the page.

    :param args: arguments of ``saver demo``
    :param figures: content of ``demo.json``
    :param parts: further variables of the template
    :return: HTML
    """
    evaluations, learning = figures["evaluations"], figures["learning"]
    columns = {**EVALUATION_COLUMNS, **COLLISIONS_COLUMN}
    return rendered(
        "saver_advisors.cli",
        "demo.html.j2",
        **parts,
        **{name: figures[name] for name in ("total_s", "provenance", "evaluations")},
        episodes=args.episodes,
        seed=args.seed,
        result_columns=columns,
        result_rows=row_cells(evaluations, columns.values()),
        baselines=_described_baselines(evaluations),
        bars=_figure_uri(_bars(evaluations)) if evaluations else "",
        robot={**figures["robot"], "data": video_uri(args.output / ROBOT_VIDEO)},
        learning={
            **learning,
            "env": ONE_ARM_ID,
            "figure": _learning_figure(learning["runs"]),
            "columns": CURVE_COLUMNS,
            "rows": row_cells(learning["runs"], CURVE_COLUMNS.values()),
        },
    )


def _described_baselines(evaluations: list[dict[str, Any]]) -> str:
    """Describe the baselines in words."""
    names = {one["policy"].partition(":")[0] for one in evaluations}
    words = {
        "side-by-side": "the single-arm teacher on every arm, each ignoring the others",
        "random": "random actions",
    }
    return ", and ".join(text for name, text in words.items() if name in names)


def _learning_figure(summaries: list[dict[str, Any]]) -> str:
    if not summaries:
        return ""
    runs = [drawn_run(one, {}) for one in summaries]
    return _figure_uri(draw(runs, PANELS[:2]))


def _bars(evaluations: list[dict[str, Any]]) -> Any:
    """Draw success rates with confidence intervals, one bar per policy."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 0.9 + 0.45 * len(evaluations)), layout="constrained", dpi=120)
    axes = figure.subplots()
    names = [
        f"{one['policy']}\n{environment_text(one['env'], one['env_kwargs'])}" for one in evaluations
    ]
    rates = [one["success_rate"] for one in evaluations]
    margins = abs(np.array([one["ci95"] for one in evaluations]).T - rates)
    compared = [":" in one["policy"] or one["policy"] == "random" for one in evaluations]
    colours = ["0.65" if plain else COLOURS[0] for plain in compared]
    axes.barh(names, rates, xerr=margins, color=colours, height=0.62, error_kw={"capsize": 3})
    axes.invert_yaxis()
    axes.set_xlim(0, 1.02)
    axes.set_xlabel("success rate, with its 95% interval")
    axes.tick_params(axis="y", labelsize=8, length=0)
    axes.grid(axis="x", color="0.9", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    return figure


def _figure_uri(figure: Any) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return _data_uri("image/png", buffer.getvalue())


def jpeg_uri(picture: Any) -> str:
    """Encode a picture as a data URI, scaled down for the page.

    :param picture: (height, width, 3), uint8
    :return: a data URI
    """
    from PIL import Image

    image = Image.fromarray(picture)
    image.thumbnail((PICTURE_WIDTH, PICTURE_WIDTH))
    buffer = io.BytesIO()
    image.save(buffer, format="JPEG", quality=88)
    return _data_uri("image/jpeg", buffer.getvalue())


def video_uri(path: Path) -> str:
    """Encode a video as a data URI.

    :param path: an MP4 file
    :return: a data URI
    """
    return _data_uri("video/mp4", path.read_bytes())


def _data_uri(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"
