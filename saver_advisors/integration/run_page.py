"""A web page about a batch of trials: how each ended, and a video of every failed one."""

from __future__ import annotations

from collections import Counter
from contextlib import closing
from pathlib import Path
from typing import Any

from saver_advisors.integration.assembly import ControlLoop
from saver_advisors.integration.recording import VideoRecorder
from saver_advisors.integration.trial import SUCCEEDED, TrialRecord, run_trial


def write_report(folder: Path, loop: ControlLoop, records: list[TrialRecord]) -> Path:
    """Write the page, with the videos in the same folder.

    Failed trials are run again to be drawn. With measured latencies, a repeated trial can differ:
    the video's own caption states the outcome that it shows.

    :param folder: created if missing.
    :param loop: that ran the trials.
    :param records: of the trials.
    :return: path of the page.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    from saver_advisors.reporting.provenance import provenance

    origin = provenance()  # before videos are added to the checkout
    folder.mkdir(parents=True, exist_ok=True)
    templates = Environment(
        loader=PackageLoader("saver_advisors.integration"),
        undefined=StrictUndefined,
        autoescape=True,
    )
    page = templates.get_template("run.html.j2").render(
        rows=[_row(folder, loop, one) for one in records],
        counts=Counter(one.outcome for one in records).most_common(),
        trials=len(records),
        settings=loop.settings,
        provenance=origin,
    )
    path = folder / "index.html"
    path.write_text(page, encoding="utf-8")
    return path


def _row(folder: Path, loop: ControlLoop, record: TrialRecord) -> dict[str, Any]:
    return {
        "seed": record.seed,
        "outcome": record.outcome,
        "cause": record.cause,
        "distance": " / ".join(f"{100 * one:.1f}" for one in record.distance[-1]),
        "force": f"{record.torso_force.max():.0f}",
        "displacement": f"{1000 * record.torso_displacement.max():.1f}",
        "held": f"{100 * record.holding.mean():.0f}",
        "log": [str(event) for event in record.log],
        "video": "" if record.outcome == SUCCEEDED else _film(folder, loop, record),
    }


def _film(folder: Path, loop: ControlLoop, record: TrialRecord) -> str:
    name = f"trial-{record.seed}.mp4"
    actions = len(record.distance) - 1
    with closing(VideoRecorder(folder / name, loop, actions)) as recorder:
        recorder.end(run_trial(loop, record.seed, actions, recorder))
    return name
