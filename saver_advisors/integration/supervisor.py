"""Stages in processes of their own: started, monitored, and restarted when they end."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from saver_advisors.integration.assembly import (
    OUTPUTS,
    Change,
    ControlLoop,
    LoopSettings,
    build_loop,
)
from saver_advisors.integration.bench import RobotBench
from saver_advisors.integration.hub import Hub
from saver_advisors.integration.messages import Message

#: The three computers of the dissertation: one for perception, one for planning, one for motion.
#: Camera, encoders and servos belong to the bench's own process.
COMPUTERS: Final[Mapping[str, tuple[str, ...]]] = {
    "seeing": ("picture check", "pose", "lift", "bench frame", "filter"),
    "planning": ("policy",),
    "moving": ("set-points", "kinematics"),
}
#: A process without a sign of life for this time (s) is killed and restarted.
SIGN_WITHIN: Final = 3.0
#: Time (s) for a process to start: it imports torch and reads weights.
BEGIN_WITHIN: Final = 90.0
#: Restarts of a process before the supervisor gives up.
RESTARTS: Final = 5
#: Simulated seconds between two polls of the sockets.
LOOK_EVERY: Final = 0.004
#: Periods after which a stage counts as silent: more than on a simulated clock, since a stage in
#: another process depends on the operating system's scheduler.
SILENT_PERIODS: Final = 4.0


class SupervisorError(RuntimeError):
    """Report a process that does not start, or has ended too often."""


@dataclass
class _Computer:
    """The state of a process."""

    name: str
    stages: tuple[str, ...]
    process: subprocess.Popen[bytes]
    started: float
    signed: float | None = None
    restarts: int = 0
    timings: dict[str, list[float]] = field(default_factory=dict)


class ProcessLoop:
    """Run a loop with some stages in other processes, no faster than real time.

    :param settings: of the loop; the latencies of remote stages are not simulated.
    :param bench: sensors and servos.
    :param computers: name of a process -> the stages that it runs.
    :param change: replaces stages of the bench's own process.
    :raises ValueError: for a stage that cannot run in another process, or is listed twice.
    """

    def __init__(
        self,
        settings: LoopSettings,
        bench: RobotBench,
        computers: Mapping[str, Sequence[str]] = COMPUTERS,
        change: Change | None = None,
    ) -> None:
        self._computers_stages = _checked(settings, computers)
        elsewhere = [name for stages in self._computers_stages.values() for name in stages]
        self.settings = settings
        self.loop: ControlLoop = build_loop(settings, bench, change, elsewhere)
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

    def __exit__(self, *_: object) -> None:
        self.close()

    def start(self) -> None:
        """Start all processes and wait until they are ready.

        :raises SupervisorError: for a process that does not start.
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
        self.loop.reset(seed)

    def run_until(self, end: float, pace: float = 1.0) -> None:
        """Continue the trial, no faster than real time.

        :param end: seconds of the trial.
        :param pace: greatest number of simulated seconds per second.
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
            elif ahead < -0.1:  # slower than real time: do not catch up
                begin, start = time.monotonic(), graph.now

    def process_of(self, computer: str) -> int:
        """Return the process id of a computer, by its name."""
        return self._computers[computer].process.pid

    def timings(self) -> dict[str, list[float]]:
        """Return calls and mean wall-clock seconds of each remote stage."""
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
                _kill(one.process)
        self._computers.clear()
        self.hub.close()

    def _begin(self, name: str, stages: tuple[str, ...], restarts: int = 0) -> _Computer:
        job = {
            "group": name,
            "stages": stages,
            "settings": self.settings.to_mapping(),
            "geometry": self.loop.bench.geometry.to_mapping(),
            "publisher_port": self.hub.publisher_port,
            "results_port": self.hub.results_port,
            "parent": os.getpid(),
        }
        command = [sys.executable, "-m", "saver_advisors.integration.worker"]
        process = subprocess.Popen(command, stdin=subprocess.PIPE)
        assert process.stdin is not None
        with process.stdin as stdin:
            stdin.write(json.dumps(job).encode())
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
        """Restart processes that have ended or give no sign of life."""
        for one in list(self._computers.values()):
            status, now = one.process.poll(), time.monotonic()
            allowed = BEGIN_WITHIN if one.signed is None else SIGN_WITHIN
            silent = now - (one.started if one.signed is None else one.signed)
            if status is not None:
                self._replace(one, _ending(status))
            elif silent > allowed:
                _kill(one.process)
                self._replace(one, f"gave no sign of life for {silent:.1f} s")

    def _replace(self, one: _Computer, ending: str) -> None:
        health, name = self.loop.health, one.name
        reason = f"process {one.process.pid} {ending}"
        health.note(self.loop.graph.now, "crashed", name, reason)
        for stage in one.stages:
            health.fault(stage, reason)
        if one.restarts >= RESTARTS:
            raise SupervisorError(f"{name!r}: {reason}, after {RESTARTS} restarts")
        self._computers[name] = self._begin(name, one.stages, one.restarts + 1)


def _checked(
    settings: LoopSettings, computers: Mapping[str, Sequence[str]]
) -> dict[str, tuple[str, ...]]:
    """Return each process's stages that this loop has; processes without any are left out."""
    assigned: set[str] = set()
    result = {}
    for name, stages in computers.items():
        for stage in stages:
            if stage not in OUTPUTS:
                raise ValueError(
                    f"computers[{name!r}]: stage {stage!r} cannot be elsewhere; those that can are "
                    f"{', '.join(OUTPUTS)}"
                )
            if stage in assigned:
                raise ValueError(f"computers: stage {stage!r} is in two places")
            assigned.add(stage)
        own = tuple(stage for stage in settings.order if stage in stages)
        if own:
            result[name] = own
    return result


def _kill(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()


def _ending(status: int | None) -> str:
    if status is None:
        return "too slow"
    return f"ended by signal {-status}" if status < 0 else f"ended with status {status}"
