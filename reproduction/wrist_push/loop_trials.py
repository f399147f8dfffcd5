"""Play the trials and injections of ``python -m reproduction wrist-push`` on several processes."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import cache, partial
from typing import Any, Final

import numpy as np

from reproduction.command_parts import Share
from reproduction.wrist_push.faults import FAULTS
from reproduction.wrist_push.injections import ALLOWED, inject
from saver_advisors.evaluation.statistics import success_interval
from saver_advisors.integration.assembly import LoopSettings, build_loop
from saver_advisors.integration.messages import Message, Person
from saver_advisors.integration.trial import PUSHING, REACHING, SUCCEEDED, run_trial
from saver_advisors.integration.wrist_bench import WristBench
from saver_advisors.training.threads import one_thread_of_algebra
from saver_envs.tasks.wrist_push import WristPush

#: Trials of a job.
_CHUNK: Final = 5
#: Largest number of durations that a job keeps of each stage.
_KEPT: Final = 400


@cache
def _own_bench() -> Any:
    """Compile this process's bench once."""
    return WristBench()


@one_thread_of_algebra()
def _inject(seed: int, settings: LoopSettings, fault: str) -> dict[str, Any]:
    return inject(settings, _own_bench(), fault, seed)


@one_thread_of_algebra()
def _play(seeds: Sequence[int], settings: LoopSettings) -> dict[str, Any]:
    """Play trials, and return their outcomes and the durations of stages."""
    loop = build_loop(settings, _own_bench())
    ages: list[float] = []

    def look(topic: str, message: Message, now: float) -> None:
        if topic == "action":
            person = loop.graph.boxes["person"].latest
            assert isinstance(person, Person)
            ages.append(now - person.stamp.time)

    loop.graph.observers.append(look)
    began = time.perf_counter()
    trials = [run_trial(loop, seed).summary() for seed in seeds]
    return {
        "trials": trials,
        "wall_s": time.perf_counter() - began,
        "stages": {
            name: {"calls": len(seconds), "seconds": _thinned(seconds)}
            for name, seconds in loop.graph.seconds.items()
        },
        "ages": _thinned(ages),
    }


def _thinned(values: Sequence[float]) -> list[float]:
    """Select evenly spaced values, a few hundred at most."""
    step = max(1, len(values) // _KEPT)
    return list(values[::step])


def play_row(share: Share, settings: LoopSettings, trials: int, seed: int) -> dict[str, Any]:
    """Play the trials of a row.

    :param share: runs jobs, see :func:`~reproduction.command_parts.shares`.
    :param settings: settings of the loop.
    :param trials: number of trials.
    :param seed: seed of the first trial.
    :return: JSON-able figures; of each stage its rate in simulated time, and a call's wall clock.
    """
    seeds = range(seed, seed + trials)
    chunks = [seeds[first : first + _CHUNK] for first in range(0, trials, _CHUNK)]
    began = time.perf_counter()
    results = share("trials", partial(_play, settings=settings), chunks)
    elapsed = time.perf_counter() - began
    played = [one for result in results for one in result["trials"]]
    simulated = sum(one["seconds"] for one in played)
    busy = sum(result["wall_s"] for result in results)
    ages = 1000 * np.concatenate([result["ages"] for result in results])
    outcomes = [one["outcome"] for one in played]
    succeeded = outcomes.count(SUCCEEDED)
    harmed = sum(
        one["torso_force_n"] > WristPush.torso_force_limit
        or one["torso_displacement_m"] > WristPush.torso_displacement_limit
        for one in played
    )
    stages = {}
    for stage in results[0]["stages"]:
        parts = [result["stages"][stage] for result in results]
        taken = 1000 * np.concatenate([part["seconds"] for part in parts])
        stages[stage] = {
            "rate_hz": sum(part["calls"] for part in parts) / simulated,
            "median_ms": float(np.median(taken)),
            "p95_ms": float(np.quantile(taken, 0.95)),
        }
    return {
        "trials": len(played),
        "succeeded": succeeded,
        "failed_reaching": outcomes.count(REACHING),
        "failed_pushing": outcomes.count(PUSHING),
        "ci95": success_interval(succeeded, len(played)),
        "harmed": harmed,
        "held_share": float(np.mean([one["held_share"] for one in played])),
        "real_time_share": simulated / busy,
        "throughput": simulated / elapsed,
        "wall_s_per_trial": busy / trials,
        "age_ms": [float(np.median(ages)), float(np.quantile(ages, 0.95))],
        "stages": stages,
        "outcomes": played,
    }


def fault_row(
    share: Share, settings: LoopSettings, fault: str, injections: int, seed: int
) -> dict[str, Any]:
    """Inject a fault into trials, and summarise them.

    :param share: runs jobs, see :func:`~reproduction.command_parts.shares`.
    :param settings: settings of the loop.
    :param fault: name of the fault.
    :param injections: number of trials, with one injection each.
    :param seed: seed of the first trial.
    :return: JSON-able figures.
    """
    work = partial(_inject, settings=settings, fault=fault)
    found = share(fault, work, range(seed, seed + injections))

    def times(key: str) -> list[float]:
        return [1000 * one[key] for one in found if one[key] is not None]

    still = times("still_after")
    return {
        "fault": fault,
        "words": FAULTS[fault].words,
        "injections": len(found),
        "stopped": len(still),
        "stopped_in_time": sum(one <= 1000 * ALLOWED for one in still),
        "still_ms": _spread(still),
        "held_ms": _spread(times("held_after")),
        "named_rightly": sum(one["named_rightly"] for one in found),
        "recovered": len(times("recovered_after")),
        "recovery_ms": _spread(times("recovered_after")),
        "torso_force_n": max(one["torso_force"] for one in found),
        "torso_displacement_m": max(one["torso_displacement"] for one in found),
        "each": found,
    }


def _spread(values: Sequence[float]) -> list[float] | None:
    """Return median and maximum; None without values."""
    return [float(np.median(values)), float(max(values))] if values else None
