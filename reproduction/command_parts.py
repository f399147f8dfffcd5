"""Arguments, steps and parts of pages that the commands of ``python -m reproduction`` share."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any

from saver_advisors.cli.arguments import add, add_folder, add_json, add_several, add_table
from saver_advisors.reporting.tables import link
from saver_advisors.reporting.video import FPS, HOLD, Frame

if TYPE_CHECKING:
    from saver_advisors.experiments.plots import Panel
    from saver_advisors.experiments.summary import MethodRow
    from saver_advisors.experiments.training_runs import Results


@dataclass(frozen=True)
class Drawn:
    """A figure on disk.

    :param path: of the picture
    :param caption: below the picture
    """

    path: Path
    caption: str


def add_choices(
    parser: argparse.ArgumentParser,
    flag: str,
    choices: Sequence[Any],
    purpose: str,
    default: Sequence[Any] | None = None,
    nargs: str = "+",
) -> None:
    """Declare an argument that selects some of several values.

    :param parser: the command's parser.
    :param flag: such as ``--models``.
    :param choices: the valid values, all of one type.
    :param purpose: what is selected, for the help.
    :param default: the values without the argument; all of them if None.
    :param nargs: ``*`` where none is a valid selection.
    """
    chosen = list(choices if default is None else default)
    kind = type(choices[0])
    text = f"{purpose}: any of {' '.join(map(str, choices))}"
    text += "" if chosen else " (default: none)"
    metavar = "NAME" if kind is str else "N"
    add(parser, flag, text, chosen, nargs=nargs, type=kind, choices=choices, metavar=metavar)


def add_result_arguments(parser: argparse.ArgumentParser, results: Path) -> None:
    """Add ``--results``, ``--table``, ``--figures`` and ``--json``.

    :param parser: the command's parser
    :param results: default folder of results
    """
    text = (
        "result files or folders of them: training runs, results of `saver curves`, and "
        "evaluations of reference policies"
    )
    add_several(parser, "--results", Path, [results], text, "PATH")
    add_table(parser)
    add_folder(parser, "--figures", "write the figures to this folder")
    add_json(parser)


Share = Callable[[str, Callable[[Any], Any], Sequence[Any]], list[Any]]
"""Receives a title, a function and the jobs that it is called with, and returns its results."""


@contextmanager
def shares(processes: int) -> Iterator[Share]:
    """Provide a function that runs jobs, in this process or in several.

    :param processes: number of processes.
    :return: a context manager.
    """
    from tqdm import tqdm

    # Spawn, since graphics contexts, threads and torch's generators do not survive a fork.
    spawn = get_context("spawn")
    with ProcessPoolExecutor(processes, spawn) if processes > 1 else nullcontext() as pool:

        def share(title: str, work: Callable[[Any], Any], jobs: Sequence[Any]) -> list[Any]:
            results = map(work, jobs) if pool is None else pool.map(work, jobs)
            return list(tqdm(results, title, total=len(jobs), unit="job", dynamic_ncols=True))

        yield share


def write_comparison(
    args: argparse.Namespace,
    figures: dict[str, Any],
    draw: Callable[[Path], list[Drawn]],
    page: Callable[[list[dict[str, str]]], str],
) -> int:
    """Write the requested files of a comparison of training runs: JSON, pictures and page.

    :param args: with the arguments of
        :func:`add_result_arguments`.
    :param figures: everything that was computed.
    :param draw: draws the figures into a folder, which exists.
    :param page: renders the page, from the ``link`` and the ``caption`` of each drawn figure.
    :return: exit status.
    """
    from saver_advisors.cli.arguments import write_json

    # First, since the provenance says whether the checkout has changed.
    write_json(args.json, figures)
    drawn: list[Drawn] = []
    if args.figures is not None:
        args.figures.mkdir(parents=True, exist_ok=True)
        drawn = draw(args.figures)
    if args.table is not None:
        folder = args.table.parent
        pictures = [{"link": link(one.path, folder), "caption": one.caption} for one in drawn]
        args.table.write_text(page(pictures), encoding="utf-8")
        print(f"wrote {args.table}")
    return 0


def comparison_figures(
    rows: Sequence[MethodRow], flat: Sequence[Any], findings: Sequence[Any], results: Results
) -> dict[str, Any]:
    """Collect what every comparison of training runs writes as JSON.

    :param rows: of the table.
    :param flat: the rows as a flat table.
    :param findings: the dissertation's findings, evaluated on these runs, as plain values.
    :param results: what was read.
    :return: ``rows``, ``detail`` with intervals, ``findings`` and ``skipped`` files.
    """
    return {
        "rows": list(flat),
        "detail": [row.to_mapping() for row in rows],
        "findings": list(findings),
        "skipped": [{"file": one.file, "reason": one.reason} for one in results.skipped],
    }


def save_panels(panels: Sequence[Panel], column: str, path: Path, caption: str) -> list[Drawn]:
    """Draw panels into a file.

    :param panels: see `saver_advisors.experiments.plots.draw_panels`; nothing is drawn without any.
    :param column: of the curves.
    :param path: of the picture.
    :param caption: of the figure.
    :return: the figure, if it is drawn.
    """
    from saver_advisors.experiments.plots import draw_panels

    if not panels:
        return []
    draw_panels(panels, column).savefig(path)
    print(f"wrote {path}")
    return [Drawn(path, caption)]


def print_skipped(results: Results) -> None:
    """Print which files were left out, and why.

    :param results: what was read.
    """
    for one in results.skipped:
        print(f"left out {one.file}: {one.reason}")


def under_way_list(rows: Sequence[MethodRow]) -> str:
    """List the unfinished runs, which no figure counts; empty without any."""
    told = [
        f"{row.name} seed {run.seed} ({run.curve.steps[-1]:,.0f} steps, success "
        f"{run.curve.success[-1]:.2f})"
        for row in rows
        for run in row.under_way
    ]
    return f"Not finished, and not counted: {'; '.join(told)}.\n" if told else ""


def between_markers(text: str, begin: str, end: str, content: str) -> str:
    """Replace the text between two markers.

    :param text: of a page
    :param begin: the first marker
    :param end: the second marker
    :param content: the replacement
    :return: the new text
    :raises ValueError: if a marker is missing
    """
    before, opened, rest = text.partition(begin)
    _, closed, after = rest.partition(end)
    if not opened or not closed:
        raise ValueError(f"{begin} or {end} is missing")
    return f"{before}{begin}\n{content}{end}{after}"


def write_clip(path: Path, frames: list[Frame], *, stride: int = 1, quality: int = 65) -> None:
    """Write a short animated WebP, which Markdown pages show like a picture.

    :param path: ending in ``.webp``
    :param frames: of every ``stride``-th step
    :param stride: steps between frames, so that the clip plays in real time
    :param quality: 0 to 100
    """
    from PIL import Image

    shown = [Image.fromarray(frame) for frame in frames]
    shown += shown[-1:] * (HOLD // stride)
    shown[0].save(
        path,
        save_all=True,
        append_images=shown[1:],
        duration=round(1000 * stride / FPS),
        loop=0,
        quality=quality,
        method=4,
    )
