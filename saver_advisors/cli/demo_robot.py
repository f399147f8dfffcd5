"""The first part of the demo: the whole robot, from its camera to the pushed wrists."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, Final

from saver_advisors.integration import POLICY

VIDEO: Final = "whole-robot.mp4"


def whole_robot(folder: Path, trials: int, seed: int) -> dict[str, Any]:
    """Play trials with everything learned, and record them.

    :param folder: of the video
    :param trials: how many
    :param seed: of the first of them
    :return: what is to be told: ``trials``, ``succeeded``, ``seconds``, and each trial's ``causes``
    """
    from saver_advisors.integration.assembly import ENV_ID, build_loop, settings_for
    from saver_advisors.integration.recording import Panel, VideoRecorder
    from saver_advisors.integration.trial import SUCCEEDED, run_trial
    from saver_advisors.integration.wrist_bench import WristBench
    from saver_envs.episodes import ACTION_DURATION
    from saver_envs.tasks.wrist_push import HORIZON

    began = time.perf_counter()
    bench = WristBench()
    settings = settings_for(POLICY)
    loop = build_loop(settings, bench)
    panel = Panel(loop, HORIZON * ACTION_DURATION)
    recorder = VideoRecorder(folder / VIDEO, panel, every=3)
    records = []
    try:
        for number in range(seed, seed + trials):
            records.append(run_trial(loop, number, look=recorder))
            recorder.end(records[-1])
    finally:
        recorder.close()
        panel.close()
        bench.close()
    return {
        "env": ENV_ID,
        "policy": settings.policy,
        "trials": trials,
        "succeeded": sum(one.outcome == SUCCEEDED for one in records),
        "causes": [str(one.cause or one.outcome) for one in records],
        "seconds": round(time.perf_counter() - began, 1),
    }
