"""A process of stages: reads messages from the bench's process, works, and sends results back.

python -m saver_advisors.integration.worker  < settings as JSON
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

from saver_advisors.integration.assembly import LoopSettings, build_stage
from saver_advisors.integration.bench import Cell
from saver_advisors.integration.graph import Graph
from saver_advisors.integration.health import Health
from saver_advisors.integration.hub import ALIVE, HOST, WAITING
from saver_advisors.integration.messages import Message
from saver_advisors.integration.wire import decode, encode

#: Seconds between signs of life.
SIGN_EVERY: Final = 0.1
#: A worker whose bench says nothing for so long (s) ends by itself: nobody is left to end it.
ORPHANED: Final = 60.0
_NOTHING_LATER: Final = 1e-6


class _NoPlant:
    """Here nothing moves."""

    def advance_to(self, time: float) -> None:
        """Do nothing."""


class Worker:
    """Some stages on the clock of the messages that come in.

    :param job: ``group``, ``stages``, ``settings``, ``cell``, ``publisher_port``,
        ``results_port``, ``parent``
    """

    def __init__(self, job: Mapping[str, Any]) -> None:
        import zmq

        self._zmq = zmq
        self._group = str(job["group"])
        self._parent = int(job["parent"])
        settings = LoopSettings.from_mapping(job["settings"])
        # Here latency is not simulated: it takes the time that it takes.
        settings = replace(settings, latencies={})
        cell = Cell.from_mapping(job["cell"])
        names = tuple(job["stages"])
        self._health = Health(names, {})
        stages = [build_stage(name, settings, cell, self._health) for name in names]
        outputs = {stage.output for stage in stages}
        topics = {topic for stage in stages for topic in stage.inputs} - outputs
        self._graph = Graph(stages, self._health, topics)
        self._own = outputs
        self._graph.observers.append(self._send)
        self._context = zmq.Context()
        self._inputs = self._context.socket(zmq.SUB)
        self._outputs = self._context.socket(zmq.PUSH)
        for socket in (self._inputs, self._outputs):
            socket.setsockopt(zmq.LINGER, 0)
            socket.set_hwm(WAITING)
        for topic in sorted(topics):
            self._inputs.setsockopt(zmq.SUBSCRIBE, topic.encode())
        self._inputs.connect(f"{HOST}:{job['publisher_port']}")
        self._outputs.connect(f"{HOST}:{job['results_port']}")
        self._told: dict[str, Any] = {}
        self._signed = 0.0

    def run(self) -> None:
        """Work until the bench's process has gone."""
        heard = time.monotonic()
        self._sign()
        while time.monotonic() - heard < ORPHANED and os.getppid() == self._parent:
            if self._inputs.poll(round(1000 * SIGN_EVERY / 2)):
                heard = time.monotonic()
                self._take()
            self._sign()

    def _take(self) -> None:
        """Take everything that has come, and let the stages work on the newest."""
        now = self._graph.now
        while self._inputs.poll(0):
            topic, message, sent = decode(self._inputs.recv_multipart())
            if sent < now - 1.0:  # the bench has begun a trial anew
                self._graph.reset()
                now = 0.0
            now = max(now, sent)
            self._graph.publish(topic, message, now)
        self._graph.run_until(now + _NOTHING_LATER, _NoPlant())

    def _send(self, topic: str, message: Message, now: float) -> None:
        if topic in self._own:
            self._outputs.send_multipart(encode(topic, message, now))

    def _sign(self) -> None:
        """Tell that this process lives, and who in it is not well: at once when that changes."""
        news = {
            "faults": self._health.faults(),
            "events": [[one.kind, one.stage, one.reason] for one in self._health.log],
        }
        now = time.monotonic()
        if news == self._told and now - self._signed < SIGN_EVERY:
            return
        self._told, self._signed = {**news, "events": []}, now
        self._health.log.clear()
        sign = {"group": self._group, "process": os.getpid(), "stages": self._timings(), **news}
        self._outputs.send_multipart([ALIVE, json.dumps(sign).encode()])

    def _timings(self) -> dict[str, list[float]]:
        """Calls and mean wall-clock seconds of each stage."""
        return {
            name: [timing.calls, sum(timing.seconds) / max(timing.calls, 1)]
            for name, timing in self._graph.timings.items()
        }


def main() -> int:
    """Read what to do from the standard input and do it."""
    from saver_advisors.training.threads import one_thread_of_algebra

    job = json.load(sys.stdin)
    with one_thread_of_algebra():
        Worker(job).run()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
