"""Inject one fault while the arms move: measure how soon they stop, and whether they resume."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from reproduction.wrist_push.faults import FAULTS, with_fault
from saver_advisors.integration.assembly import LoopSettings, build_loop
from saver_advisors.integration.health import STOPPED
from saver_advisors.integration.messages import Message, ServoCommand
from saver_advisors.integration.wrist_bench import WristBench

#: Interval of a trial (s) in which the fault begins, while the hands approach or push.
BEGIN: Final = (0.5, 1.5)
#: Duration of the fault, and of the observation after it (s).
DURATION, AFTERWARDS = 0.6, 0.8
#: Tool speed below which an arm counts as stopped (m/s).
STILL: Final = 0.01
#: Time within which the arms must stop (s), SPEC.
ALLOWED: Final = 0.100


def inject(settings: LoopSettings, bench: WristBench, fault: str, seed: int) -> dict[str, Any]:
    """Run the beginning of a trial with a fault.

    :param settings: of the loop.
    :param bench: for the loop.
    :param fault: a name in `FAULTS`.
    :param seed: of the trial, and of the time of the fault.
    :return: the effects of the fault, for JSON: ``begin`` of the fault, seconds of the trial;
        ``speed`` of the faster tool then, m/s; seconds ``held_after`` which the first command to
        hold came and ``still_after`` which both tools had stopped for good, None if they did not;
        the stage ``named`` first in the log, empty without any, and whether it is the faulty one or
        the one that detects the fault (``named_rightly``); seconds ``recovered_after`` which the
        arms were free again, from the fault's end, None if they were not; and the peaks
        ``torso_force`` (N) and ``torso_displacement`` (m) from the fault's begin on.
    """
    kind = FAULTS[fault]
    begin = float(np.random.default_rng(seed).uniform(*BEGIN))
    end = begin + DURATION
    loop = build_loop(settings, bench, with_fault(kind, [(begin, end)]))
    rows: list[tuple[float, bool, float]] = []

    def watch(topic: str, message: Message, now: float) -> None:
        if isinstance(message, ServoCommand):
            velocity = bench.episodes.simulation.arm_state().tool_velocity
            rows.append((now, message.holding, float(np.linalg.norm(velocity, axis=-1).max())))

    loop.reset(seed)
    loop.graph.observers.append(watch)
    loop.graph.run_until(begin, bench.advance_to)
    bench.taken_peaks()
    loop.graph.run_until(end + AFTERWARDS, bench.advance_to)
    force, displacement = bench.taken_peaks()
    times, held, speeds = (np.array(column) for column in zip(*rows, strict=True))
    during, after = (times >= begin) & (times < end), times >= end
    stops = [event for event in loop.health.log if event.kind == STOPPED and event.time >= begin]
    named = stops[0].stage if stops else ""
    return {
        "fault": fault,
        "seed": seed,
        "begin": begin,
        "speed": float(speeds[times < begin][-1]),
        "held_after": _first(times[during] - begin, held[during]),
        "still_after": _settled(times[during] - begin, speeds[during] < STILL),
        "named": named,
        "named_rightly": named == (kind.detected_by or kind.stage),
        "recovered_after": _first(times[after] - end, ~held[after]),
        "torso_force": force,
        "torso_displacement": displacement,
    }


def _first(times: np.ndarray, hold: np.ndarray) -> float | None:
    """Return the first time at which a condition holds."""
    found = np.flatnonzero(hold)
    return float(times[found[0]]) if found.size else None


def _settled(times: np.ndarray, hold: np.ndarray) -> float | None:
    """Return the time from which a condition holds until the end."""
    if not hold.size or not hold[-1]:
        return None
    broken = np.flatnonzero(~hold)
    return float(times[broken[-1] + 1]) if broken.size else 0.0
