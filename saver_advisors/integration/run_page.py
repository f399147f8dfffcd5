"""A page about a batch of trials: how each ended, and a video of every one that failed."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

from saver_advisors.integration.assembly import Loop
from saver_advisors.integration.recording import Panel, VideoRecorder
from saver_advisors.integration.trial import SUCCEEDED, TrialRecord, run_trial
from saver_envs.episodes import ACTION_DURATION


def write_report(folder: Path, loop: Loop, records: list[TrialRecord]) -> Path:
    """Write the page, and the videos beside it.

    Failed trials are played once more to be drawn. Where latencies are measured a trial does not
    repeat itself exactly: what the video shows is judged anew, and its own caption tells how.

    :param folder: made if need be
    :param loop: that played the trials
    :param records: of the trials
    :return: path of the page
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    from saver_advisors.reporting.provenance import provenance

    origin = provenance()  # before videos lie in the checkout and make it differ
    folder.mkdir(parents=True, exist_ok=True)
    rows = [_row(one) for one in records]
    for record, row in zip(records, rows, strict=True):
        if record.outcome != SUCCEEDED:
            row["video"] = _film(folder, loop, record)
    templates = Environment(
        loader=PackageLoader("saver_advisors.integration"),
        undefined=StrictUndefined,
        autoescape=True,
    )
    page = templates.get_template("run.html.j2").render(
        rows=rows,
        counts=Counter(one.outcome for one in records).most_common(),
        trials=len(records),
        settings=loop.settings,
        provenance=origin,
    )
    path = folder / "index.html"
    path.write_text(page, encoding="utf-8")
    return path


def _row(record: TrialRecord) -> dict[str, Any]:
    return {
        "seed": record.seed,
        "outcome": record.outcome,
        "cause": record.cause,
        "distance": " / ".join(f"{100 * one:.1f}" for one in record.distance[-1]),
        "force": f"{record.torso_force.max():.0f}",
        "displacement": f"{1000 * record.torso_displacement.max():.1f}",
        "held": f"{100 * record.holding.mean():.0f}",
        "log": [str(event) for event in record.log],
        "video": "",
    }


def _film(folder: Path, loop: Loop, record: TrialRecord) -> str:
    name = f"trial-{record.seed}.mp4"
    actions = len(record.distance) - 1
    panel = Panel(loop, actions * ACTION_DURATION)
    recorder = VideoRecorder(folder / name, panel)
    try:
        recorder.end(run_trial(loop, record.seed, actions, recorder))
    finally:
        recorder.close()
        panel.close()
    return name
