"""The first part of the demo: the whole robot, from its camera to the pushed wrists."""

from __future__ import annotations

import time
from contextlib import closing
from pathlib import Path
from typing import Any, Final

from saver_advisors.integration import POLICY

VIDEO: Final = "whole-robot.mp4"


def whole_robot(folder: Path, trials: int, seed: int) -> dict[str, Any]:
    """Run trials with all learned components, and record them.

    :param folder: of the video.
    :param trials: number of trials.
    :param seed: of the first trial.
    :return: ``env``, ``policy``, ``trials``, ``succeeded``, ``causes`` of each trial, ``seconds``.
    """
    from saver_advisors.integration.assembly import build_loop, settings_for
    from saver_advisors.integration.casualty import ENV_ID
    from saver_advisors.integration.recording import VideoRecorder
    from saver_advisors.integration.trial import SUCCEEDED, run_trial
    from saver_advisors.integration.wrist_bench import WristBench

    began = time.perf_counter()
    settings = settings_for(POLICY)
    records = []
    with closing(WristBench()) as bench:
        loop = build_loop(settings, bench)
        with closing(VideoRecorder(folder / VIDEO, loop, every=3)) as recorder:
            for number in range(seed, seed + trials):
                records.append(run_trial(loop, number, look=recorder))
                recorder.end(records[-1])
    return {
        "env": ENV_ID,
        "policy": settings.policy,
        "trials": trials,
        "succeeded": sum(one.outcome == SUCCEEDED for one in records),
        "causes": [str(one.cause or one.outcome) for one in records],
        "seconds": round(time.perf_counter() - began, 1),
    }
