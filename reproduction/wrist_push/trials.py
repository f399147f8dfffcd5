"""Trials and injections of ``python -m reproduction wrist-push``, shared out to processes."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from multiprocessing import get_context
from typing import TYPE_CHECKING, Any, Final

import numpy as np

if TYPE_CHECKING:
    from saver_advisors.integration.assembly import ControlLoop

#: Trials that a process plays before it reports.
_CHUNK: Final = 5
#: Calls of a stage whose durations are kept of each such report.
_KEPT: Final = 400

Job = tuple[str, Mapping[str, Any], tuple[int, ...], str]
Share = Callable[[str, Sequence[Job]], list[dict[str, Any]]]


@contextmanager
def shares(processes: int) -> Iterator[Share]:
    """Yield what works jobs off, in this process alone or in several.

    :param processes: how many
    """
    from saver_advisors.benchmark.machine import progress

    if processes == 1:

        def alone(what: str, jobs: Sequence[Job]) -> list[dict[str, Any]]:
            with progress(what, len(jobs)) as advance:
                results = []
                for job in jobs:
                    results.append(work(job))
                    advance()
            return results

        yield alone
        return
    # Fresh processes: graphics contexts and threads do not survive a fork.
    with get_context("spawn").Pool(processes, _one_thread) as pool:

        def together(what: str, jobs: Sequence[Job]) -> list[dict[str, Any]]:
            with progress(what, len(jobs)) as advance:
                results = []
                for result in pool.imap(work, jobs):
                    results.append(result)
                    advance()
            return results

        yield together


def _one_thread() -> None:
    import torch

    os.environ["OMP_NUM_THREADS"] = "1"
    torch.set_num_threads(1)


_bench: Any = None


def _own_bench() -> Any:
    """This process's bench: compiled once."""
    global _bench
    if _bench is None:
        from saver_advisors.integration.wrist_bench import WristBench

        _bench = WristBench()
    return _bench


def work(job: Job) -> dict[str, Any]:
    """Play trials, or inject a fault into them.

    :param job: what, the loop's settings, seeds, and the fault's name where it is one
    :return: JSON-able, and the durations of stages
    """
    from saver_advisors.integration.assembly import LoopSettings, build_loop
    from saver_advisors.integration.injections import inject

    what, mapping, seeds, fault = job
    settings, bench = LoopSettings.from_mapping(mapping), _own_bench()
    if what == "inject":
        return {"injections": [asdict(inject(settings, bench, fault, s)) for s in seeds]}
    return _play(build_loop(settings, bench), seeds)


def _play(loop: ControlLoop, seeds: Sequence[int]) -> dict[str, Any]:
    from saver_advisors.integration.messages import Message, Person
    from saver_advisors.integration.trial import run_trial

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
    """Evenly chosen values, a few hundred at most."""
    step = max(1, len(values) // _KEPT)
    return list(values[::step])


def play_row(share: Share, settings: Any, trials: int, seed: int) -> dict[str, Any]:
    """Play a row of the table.

    :param share: works jobs off
    :param settings: of the loop
    :param trials: how many
    :param seed: of the first
    :return: JSON-able
    """
    seeds = range(seed, seed + trials)
    name = f"{'network' if settings.seeing else 'true state'}, "
    name += "learned kinematics" if settings.learned_kinematics else "exact kinematics"
    chunks = [tuple(seeds[i : i + _CHUNK]) for i in range(0, trials, _CHUNK)]
    began = time.perf_counter()
    results = share(name, [("play", settings.to_mapping(), chunk, "") for chunk in chunks])
    elapsed = time.perf_counter() - began
    played = [one for result in results for one in result["trials"]]
    simulated = sum(one["seconds"] for one in played)
    busy = sum(result["wall_s"] for result in results)
    ages = 1000 * np.concatenate([result["ages"] for result in results])
    return {
        **_counted(played),
        "real_time_share": simulated / busy,
        "throughput": simulated / elapsed,
        "wall_s_per_trial": busy / trials,
        "age_ms": [float(np.median(ages)), float(np.quantile(ages, 0.95))],
        "stages": _stages(results, simulated),
        "outcomes": played,
    }


def _counted(played: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    from saver_advisors.evaluation.statistics import success_interval
    from saver_advisors.integration.trial import PUSHING, REACHING, SUCCEEDED
    from saver_envs.tasks.wrist_push import DISPLACEMENT_LIMIT, FORCE_LIMIT

    outcomes = [one["outcome"] for one in played]
    succeeded = outcomes.count(SUCCEEDED)
    harmed = sum(
        one["torso_force_n"] > FORCE_LIMIT or one["torso_displacement_m"] > DISPLACEMENT_LIMIT
        for one in played
    )
    return {
        "trials": len(played),
        "succeeded": succeeded,
        "failed_reaching": outcomes.count(REACHING),
        "failed_pushing": outcomes.count(PUSHING),
        "ci95": list(success_interval(succeeded, len(played))),
        "harmed": harmed,
        "held_share": float(np.mean([one["held_share"] for one in played])),
    }


def _stages(results: Sequence[Mapping[str, Any]], simulated: float) -> dict[str, Any]:
    """Rate in simulated time, and wall-clock time of a call, of each stage."""
    table = {}
    for name in results[0]["stages"]:
        parts = [result["stages"][name] for result in results]
        taken = 1000 * np.concatenate([part["seconds"] for part in parts])
        table[name] = {
            "rate_hz": sum(part["calls"] for part in parts) / simulated,
            "median_ms": float(np.median(taken)),
            "p95_ms": float(np.quantile(taken, 0.95)),
        }
    return table


def fault_row(
    share: Share, settings: Any, fault: str, injections: int, seed: int
) -> dict[str, Any]:
    """Inject a fault into as many trials, and sum up.

    :param share: works jobs off
    :param settings: of the loop
    :param fault: its name
    :param injections: how many
    :param seed: of the first
    :return: JSON-able
    """
    from saver_advisors.integration.faults import FAULTS
    from saver_advisors.integration.injections import ALLOWED

    jobs = [
        ("inject", settings.to_mapping(), (one,), fault) for one in range(seed, seed + injections)
    ]
    found = [one for result in share(fault, jobs) for one in result["injections"]]

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
    """Median and maximum, None of nothing."""
    return [float(np.median(values)), float(max(values))] if values else None
