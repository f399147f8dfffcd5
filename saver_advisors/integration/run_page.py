"""A web page about a batch of trials: how each ended, and a video of every failed one."""

from __future__ import annotations

from collections import Counter
from contextlib import closing
from pathlib import Path

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
    from saver_advisors.reporting.provenance import provenance
    from saver_advisors.reporting.templates import rendered

    origin = provenance()  # before videos are added to the checkout
    folder.mkdir(parents=True, exist_ok=True)
    failed = [one for one in records if one.outcome != SUCCEEDED]
    videos = {one.seed: _film(folder, loop, one) for one in failed}
    page = rendered(
        "saver_advisors.integration",
        "run.html.j2",
        records=records,
        videos=videos,
        counts=Counter(one.outcome for one in records).most_common(),
        settings=loop.settings,
        provenance=origin,
    )
    path = folder / "index.html"
    path.write_text(page, encoding="utf-8")
    return path


def _film(folder: Path, loop: ControlLoop, record: TrialRecord) -> str:
    name = f"trial-{record.seed}.mp4"
    actions = len(record.distance) - 1
    with closing(VideoRecorder(folder / name, loop, actions)) as recorder:
        recorder.end(run_trial(loop, record.seed, actions, recorder))
    return name
