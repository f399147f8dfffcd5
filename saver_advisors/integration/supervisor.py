"""Stages in processes of their own: started, watched, and started again when they stop."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Final

from saver_advisors.integration.assembly import OUTPUTS, Change, Loop, LoopSettings, build_loop
from saver_advisors.integration.bench import Bench
from saver_advisors.integration.hub import Hub
from saver_advisors.integration.messages import Message

#: The three computers of the dissertation: one sees, one plans, one turns plans into joint motion.
#: Camera, encoders and servos belong to the bench's own process.
COMPUTERS: Final[Mapping[str, tuple[str, ...]]] = {
    "seeing": ("picture check", "pose", "lift", "bench frame", "filter"),
    "planning": ("policy",),
    "moving": ("set-points", "kinematics"),
}
#: A process that gives no sign of life for so long (s) is ended and started anew.
SIGN_WITHIN: Final = 3.0
#: A process has so long (s) to begin: it imports torch and reads weights.
BEGIN_WITHIN: Final = 90.0
#: How often a process is started anew before the supervisor gives it up.
RESTARTS: Final = 5
#: Simulated seconds between two looks at the sockets.
LOOK_EVERY: Final = 0.004
#: Stages elsewhere answer when their machine lets them: more patience than on one clock.
SILENT_PERIODS: Final = 4.0


class SupervisorError(RuntimeError):
    """A process that does not begin, or has ended too often."""


@dataclass
class _Computer:
    """A process and what is known of it."""

    name: str
    stages: tuple[str, ...]
    process: subprocess.Popen[bytes]
    started: float
    signed: float | None = None
    restarts: int = 0
    timings: dict[str, list[float]] = field(default_factory=dict)


class ProcessLoop:
    """A loop with some stages elsewhere, in step with the real time.

    :param settings: of the loop; latencies of stages elsewhere are what they are
    :param bench: what it runs on
    :param computers: name of a process -> the stages that it runs
    :param change: replaces stages of the bench's own process
    :raises ValueError: for a stage that cannot be elsewhere, or is in two places
    """

    def __init__(
        self,
        settings: LoopSettings,
        bench: Bench,
        computers: Mapping[str, Sequence[str]] = COMPUTERS,
        change: Change | None = None,
    ) -> None:
        self._computers_stages = _checked(settings, computers)
        elsewhere = [name for stages in self._computers_stages.values() for name in stages]
        self.settings = settings
        self.loop: Loop = build_loop(settings, bench, change, elsewhere)
        self.hub = Hub([*self.loop.graph.boxes])
        self.loop.graph.observers.append(self.hub.forward)
        self._computers: dict[str, _Computer] = {}

    def __enter__(self) -> ProcessLoop:
        try:
            self.start()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def start(self) -> None:
        """Start all processes and wait until they are ready.

        :raises SupervisorError: where one does not begin
        """
        for name, stages in self._computers_stages.items():
            self._computers[name] = self._begin(name, stages)
        end = time.monotonic() + BEGIN_WITHIN
        while not all(one.signed is not None for one in self._computers.values()):
            self._poll()
            for one in self._computers.values():
                status = one.process.poll()
                if status is not None or time.monotonic() > end:
                    raise SupervisorError(f"process {one.name!r} did not begin: {_ending(status)}")
            time.sleep(0.02)

    def reset(self, seed: int) -> None:
        """Begin a trial, drawn from a seed."""
        self.loop.bench.reset(seed)
        self.loop.graph.reset()

    def run_until(self, end: float, pace: float = 1.0) -> None:
        """Let the trial go on, no faster than real time.

        :param end: seconds of the trial
        :param pace: simulated seconds a second, at most
        """
        graph, bench = self.loop.graph, self.loop.bench
        begin, start = time.monotonic(), graph.now
        while graph.now < end - 1e-9:
            self._poll()
            self._watch()
            graph.run_until(min(graph.now + LOOK_EVERY, end), bench)
            ahead = (graph.now - start) / pace - (time.monotonic() - begin)
            if ahead > 0:
                time.sleep(ahead)
            elif ahead < -0.1:  # too slow for real time: no hurry to catch up
                begin, start = time.monotonic(), graph.now

    def process_of(self, computer: str) -> int:
        """The id of a process, by the name of its computer."""
        return self._computers[computer].process.pid

    def timings(self) -> dict[str, list[float]]:
        """Calls and mean wall-clock seconds of the stages elsewhere."""
        return {
            name: list(timing)
            for one in self._computers.values()
            for name, timing in one.timings.items()
        }

    def close(self) -> None:
        """End all processes and close the sockets."""
        for one in self._computers.values():
            one.process.terminate()
        for one in self._computers.values():
            try:
                one.process.wait(5)
            except subprocess.TimeoutExpired:
                one.process.kill()
                one.process.wait()
        self._computers.clear()
        self.hub.close()

    def _begin(self, name: str, stages: tuple[str, ...], restarts: int = 0) -> _Computer:
        job = {
            "group": name,
            "stages": stages,
            "settings": self.settings.to_mapping(),
            "cell": self.loop.bench.cell.to_mapping(),
            "publisher_port": self.hub.publisher_port,
            "results_port": self.hub.results_port,
            "parent": os.getpid(),
        }
        process = subprocess.Popen(
            [sys.executable, "-m", "saver_advisors.integration.worker"], stdin=subprocess.PIPE
        )
        assert process.stdin is not None
        process.stdin.write(json.dumps(job).encode())
        process.stdin.close()
        return _Computer(name, stages, process, time.monotonic(), restarts=restarts)

    def _poll(self) -> None:
        graph = self.loop.graph

        def arrival(topic: str, message: Message) -> None:
            if topic in graph.boxes:
                graph.publish(topic, message, graph.now)

        self.hub.poll(arrival, self._sign_of_life)

    def _sign_of_life(self, sign: dict[str, Any]) -> None:
        one = self._computers.get(str(sign.get("group")))
        if one is None or sign.get("process") != one.process.pid:
            return
        health, now = self.loop.health, self.loop.graph.now
        if one.signed is None and one.restarts:
            health.note(now, "restarted", one.name, f"process {one.process.pid} is ready")
        one.signed = time.monotonic()
        one.timings = sign.get("stages", {})
        faults = sign.get("faults", {})
        for stage in one.stages:
            if stage in faults:
                health.fault(stage, str(faults[stage]))
            else:
                health.well(stage)
        for kind, stage, reason in sign.get("events", ()):
            health.note(now, str(kind), str(stage), str(reason))

    def _watch(self) -> None:
        """Start processes anew that have ended or give no sign of life."""
        for name, one in list(self._computers.items()):
            status, now = one.process.poll(), time.monotonic()
            allowed = BEGIN_WITHIN if one.signed is None else SIGN_WITHIN
            silent = now - (one.started if one.signed is None else one.signed)
            if status is None and silent <= allowed:
                continue
            if status is None:
                reason = f"process {one.process.pid} gave no sign of life for {silent:.1f} s"
                one.process.kill()
                one.process.wait()
            else:
                reason = f"process {one.process.pid} {_ending(status)}"
            self._replace(name, one, reason)

    def _replace(self, name: str, one: _Computer, reason: str) -> None:
        health, now = self.loop.health, self.loop.graph.now
        health.note(now, "crashed", name, reason)
        for stage in one.stages:
            health.fault(stage, reason)
        if one.restarts >= RESTARTS:
            raise SupervisorError(f"{name!r}: {reason}, after {RESTARTS} restarts")
        self._computers[name] = self._begin(name, one.stages, one.restarts + 1)


def _checked(
    settings: LoopSettings, computers: Mapping[str, Sequence[str]]
) -> dict[str, tuple[str, ...]]:
    """The stages of each process that this loop has; processes without any are left out."""
    placed: set[str] = set()
    result = {}
    for name, stages in computers.items():
        for stage in stages:
            if stage not in OUTPUTS:
                raise ValueError(
                    f"computers[{name!r}]: stage {stage!r} cannot be elsewhere; those that can are "
                    f"{', '.join(OUTPUTS)}"
                )
            if stage in placed:
                raise ValueError(f"computers: stage {stage!r} is in two places")
            placed.add(stage)
        own = tuple(stage for stage in settings.order if stage in stages)
        if own:
            result[name] = own
    return result


def _ending(status: int | None) -> str:
    if status is None:
        return "too slow"
    return f"ended by signal {-status}" if status < 0 else f"ended with status {status}"
