"""Stages in processes of their own: started, monitored, and restarted when they end."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Final

from saver_advisors.integration.assembly import OUTPUTS, ControlLoop, LoopSettings, build_loop
from saver_advisors.integration.bench import RobotBench
from saver_advisors.integration.hub import Hub
from saver_advisors.integration.wire import KINDS, SignOfLife, Wire

#: The three computers of the dissertation: one for perception, one for planning, one for motion.
#: Camera, encoders and servos belong to the bench's own process, as does the check of pictures,
#: which would send each of them there and back.
COMPUTERS: Final[Mapping[str, tuple[str, ...]]] = {
    "seeing": ("pose", "lift", "bench frame", "filter"),
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
    """The state of a process.

    :param key: the public key by which its messages are recognised.
    :param heard: time of its start or its last sign of life, seconds of the monotonic clock.
    :param ready: whether it has given a sign of life.
    """

    name: str
    stages: tuple[str, ...]
    process: subprocess.Popen[bytes]
    key: str
    heard: float
    ready: bool = False
    restarts: int = 0


class ProcessLoop:
    """Run a loop with some stages in other processes, no faster than real time.

    :param settings: of the loop; the latencies of remote stages are not simulated.
    :param bench: sensors and servos.
    :param computers: name of a process -> the stages that it runs.
    :raises ValueError: for a stage that cannot run in another process, or is listed twice.
    """

    def __init__(
        self,
        settings: LoopSettings,
        bench: RobotBench,
        computers: Mapping[str, Sequence[str]] = COMPUTERS,
    ) -> None:
        self._computers_stages = _checked(settings, computers)
        elsewhere = [name for stages in self._computers_stages.values() for name in stages]
        self.loop: ControlLoop = build_loop(settings, bench, elsewhere=elsewhere)
        topics = self.loop.graph.boxes.keys() & KINDS.keys()
        self.hub = Hub(Wire(bench.geometry), topics, [OUTPUTS[name] for name in elsewhere])
        self.loop.graph.observers.append(self.hub.forward)
        #: Calls and mean wall-clock seconds of each remote stage.
        self.timings: dict[str, list[float]] = {}
        self._computers: dict[str, _Computer] = {}

    def __enter__(self) -> ProcessLoop:
        try:
            self._start()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _start(self) -> None:
        """Start all processes and wait until they are ready.

        :raises SupervisorError: for a process that does not start.
        """
        for name, stages in self._computers_stages.items():
            self._computers[name] = self._begin(name, stages)
        end = time.monotonic() + BEGIN_WITHIN
        while not all(one.ready for one in self._computers.values()):
            self._poll()
            for one in self._computers.values():
                status = one.process.poll()
                if status is not None or time.monotonic() > end:
                    raise SupervisorError(f"process {one.name!r} did not begin: {_ending(status)}")
            time.sleep(0.02)

    def run_until(self, end: float) -> None:
        """Continue the trial, no faster than real time.

        :param end: seconds of the trial.
        """
        graph, bench = self.loop.graph, self.loop.bench
        begin, start = time.monotonic(), graph.now
        while graph.now < end - 1e-9:
            self._poll()
            self._watch()
            graph.run_until(min(graph.now + LOOK_EVERY, end), bench.advance_to)
            ahead = graph.now - start - (time.monotonic() - begin)
            if ahead > 0:
                time.sleep(ahead)
            elif ahead < -0.1:  # slower than real time: do not catch up
                begin, start = time.monotonic(), graph.now

    def close(self) -> None:
        """End all processes and close the sockets."""
        for one in self._computers.values():
            _kill(one.process)
        self._computers.clear()
        self.hub.close()

    def _begin(self, name: str, stages: tuple[str, ...], restarts: int = 0) -> _Computer:
        keys = self.hub.admit({OUTPUTS[stage]: stage for stage in stages})
        job = {
            "stages": stages,
            "settings": self.loop.settings.to_mapping(),
            "geometry": self.loop.bench.geometry.to_mapping(),
            "keys": keys,
            "parent": os.getpid(),
        }
        # -P: no module of the current folder takes the place of an installed one.
        command = [sys.executable, "-P", "-m", "saver_advisors.integration.worker"]
        process = subprocess.Popen(command, stdin=subprocess.PIPE)
        assert process.stdin is not None
        with process.stdin as stdin:
            stdin.write(json.dumps(job).encode())
        heard = time.monotonic()
        return _Computer(name, stages, process, keys["public"], heard, restarts=restarts)

    def _poll(self) -> None:
        graph = self.loop.graph
        for topic, message in self.hub.received(self._sign_of_life):
            # One of the last trial has a later time; it must not move the arms in this one.
            if message.stamp.time <= graph.now:
                graph.publish(topic, message, graph.now)

    def _sign_of_life(self, key: str, sign: SignOfLife) -> None:
        one = next((one for one in self._computers.values() if one.key == key), None)
        if one is None:
            return
        health, now = self.loop.health, self.loop.graph.now
        if one.restarts and not one.ready:
            health.note(now, "restarted", one.name, f"process {one.process.pid} is ready")
        one.ready, one.heard = True, time.monotonic()
        for stage in one.stages:
            if stage in sign.stages:
                self.timings[stage] = sign.stages[stage]
            health.faults.pop(stage, None)
            if stage in sign.faults:
                health.faults[stage] = sign.faults[stage]
        for kind, stage, reason in sign.events:
            if stage in one.stages:
                health.note(now, kind, stage, reason)

    def _watch(self) -> None:
        """Restart processes that have ended or give no sign of life."""
        for one in list(self._computers.values()):
            status, silent = one.process.poll(), time.monotonic() - one.heard
            if status is not None:
                self._replace(one, _ending(status))
            elif silent > (SIGN_WITHIN if one.ready else BEGIN_WITHIN):
                _kill(one.process)
                self._replace(one, f"gave no sign of life for {silent:.1f} s")

    def _replace(self, one: _Computer, ending: str) -> None:
        health, name = self.loop.health, one.name
        self.hub.expel(one.key)
        reason = f"process {one.process.pid} {ending}"
        health.note(self.loop.graph.now, "crashed", name, reason)
        for stage in one.stages:
            health.faults[stage] = reason
        if one.restarts >= RESTARTS:
            raise SupervisorError(f"{name!r}: {reason}, after {RESTARTS} restarts")
        self._computers[name] = self._begin(name, one.stages, one.restarts + 1)


def _checked(
    settings: LoopSettings, computers: Mapping[str, Sequence[str]]
) -> dict[str, tuple[str, ...]]:
    """Return each process's stages that this loop has; processes without any are left out."""
    for stage, count in Counter(chain.from_iterable(computers.values())).items():
        if stage not in OUTPUTS:
            possible = ", ".join(OUTPUTS)
            raise ValueError(f"computers: stage {stage!r} cannot be elsewhere, only {possible}")
        if count > 1:
            raise ValueError(f"computers: stage {stage!r} is in two places")
    own = {
        name: tuple(stage for stage in settings.order if stage in stages)
        for name, stages in computers.items()
    }
    return {name: stages for name, stages in own.items() if stages}


def _kill(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()


def _ending(status: int | None) -> str:
    if status is None:
        return "too slow"
    return f"ended by signal {-status}" if status < 0 else f"ended with status {status}"
