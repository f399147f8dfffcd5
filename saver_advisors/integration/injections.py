"""One fault, injected while the arms move: how soon they stand still, and whether they go on."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from saver_advisors.integration.assembly import LoopSettings, build_loop
from saver_advisors.integration.faults import FAULTS, with_fault
from saver_advisors.integration.messages import Message, ServoCommand
from saver_advisors.integration.wrist_bench import WristBench

#: A fault begins within this time (s) of a trial, when hands are on their way or push ...
BEGIN: Final = (0.5, 1.5)
#: ... and lasts so long (s), after which the loop has so long to go on (s).
DURATION, AFTERWARDS = 0.6, 0.8
#: Arms stand still below this speed of the tools (m/s).
STILL: Final = 0.01
#: What SPEC and issue ask for: the arms stand within so long (s).
ALLOWED: Final = 0.100


@dataclass(frozen=True)
class Injection:
    """What a fault has led to.

    :param fault: its name
    :param seed: of the trial
    :param begin: of the fault, seconds of the trial
    :param speed: of the faster tool when it began, m/s
    :param held_after: seconds from then until the servos were told to hold; None if never
    :param still_after: seconds from then until both tools stood, and stood on; None if never
    :param named: the stage that the log named first, empty where none was
    :param named_rightly: whether it is the stage at fault, or one that detects it
    :param recovered_after: seconds from the fault's end until the arms were free; None if never
    :param torso_force: highest from the fault's begin on, newtons
    :param torso_displacement: highest, metres
    """

    fault: str
    seed: int
    begin: float
    speed: float
    held_after: float | None
    still_after: float | None
    named: str
    named_rightly: bool
    recovered_after: float | None
    torso_force: float
    torso_displacement: float

    def to_mapping(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return asdict(self)


#: Which stage notices a fault, where it is not the one that is at fault: a picture's fault is
#: found by whoever looks at it, a policy's wish by the stage that checks it.
NOTICED_BY: Final = {
    "frames frozen": "picture check",
    "frames black": "picture check",
    "no person": "pose",
    "wrist hidden": "filter",
    "pose jumps": "filter",
    "unreachable point": "set-points",
    "not a number": "set-points",
}


class _Watch:
    """Keeps what servos and tools did, gate by gate."""

    def __init__(self, bench: WristBench) -> None:
        self._bench = bench
        self.times: list[float] = []
        self.held: list[bool] = []
        self.speeds: list[float] = []

    def __call__(self, topic: str, message: Message, now: float) -> None:
        if isinstance(message, ServoCommand):
            state = self._bench.episodes.simulation.arm_state()
            self.times.append(now)
            self.held.append(message.holding)
            self.speeds.append(float(np.linalg.norm(state.tool_velocity, axis=-1).max()))


def inject(settings: LoopSettings, bench: WristBench, fault: str, seed: int) -> Injection:
    """Play the beginning of a trial with a fault in it.

    :param settings: of the loop
    :param bench: it runs on
    :param fault: its name, of `FAULTS`
    :param seed: of the trial, and of the moment
    :return: what it has led to
    """
    begin = float(np.random.default_rng(seed).uniform(*BEGIN))
    end = begin + DURATION
    loop = build_loop(settings, bench, with_fault(FAULTS[fault], [(begin, end)]))
    bench.reset(seed)
    loop.graph.reset()
    watch = _Watch(bench)
    loop.graph.observers.append(watch)
    loop.graph.run_until(begin, bench)
    bench.taken_peaks()
    loop.graph.run_until(end + AFTERWARDS, bench)
    force, displacement = bench.taken_peaks()
    times = np.array(watch.times)
    held, speeds = np.array(watch.held), np.array(watch.speeds)
    during = (times >= begin) & (times < end)
    stops = [event for event in loop.health.log if event.kind == "stopped" and event.time >= begin]
    named = stops[0].stage if stops else ""
    return Injection(
        fault=fault,
        seed=seed,
        begin=begin,
        speed=float(speeds[times < begin][-1]),
        held_after=_first(times[during] - begin, held[during]),
        still_after=_settled(times[during] - begin, speeds[during] < STILL),
        named=named,
        named_rightly=named == NOTICED_BY.get(fault, FAULTS[fault].stage),
        recovered_after=_first(times[times >= end] - end, ~held[times >= end]),
        torso_force=force,
        torso_displacement=displacement,
    )


def _first(times: np.ndarray, hold: np.ndarray) -> float | None:
    """The first time at which something holds."""
    found = np.flatnonzero(hold)
    return float(times[found[0]]) if found.size else None


def _settled(times: np.ndarray, hold: np.ndarray) -> float | None:
    """The time from which on something holds to the end."""
    if not hold.size or not hold[-1]:
        return None
    broken = np.flatnonzero(~hold)
    return float(times[broken[-1] + 1]) if broken.size else 0.0
