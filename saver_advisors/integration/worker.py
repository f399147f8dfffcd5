"""A process of stages: receives messages from the bench's process, and sends results back.

python -P -m saver_advisors.integration.worker  < settings as JSON
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import zmq

from saver_advisors.integration.assembly import LoopSettings, build_stage
from saver_advisors.integration.bench import BenchGeometry
from saver_advisors.integration.graph import Graph
from saver_advisors.integration.health import Health
from saver_advisors.integration.hub import ALIVE, arrived, open_socket
from saver_advisors.integration.messages import Message
from saver_advisors.integration.wire import Wire, WireError

#: Seconds between signs of life.
SIGN_EVERY: Final = 0.1
#: A worker that receives nothing for this time (s) ends by itself.
ORPHANED: Final = 60.0
_NOTHING_LATER: Final = 1e-6


class Worker:
    """Run stages on the clock of the incoming messages.

    :param job: ``stages``, ``settings``, ``geometry``, ``keys`` and ``parent``, as
        `supervisor.ProcessLoop` writes them.
    """

    def __init__(self, job: Mapping[str, Any]) -> None:
        self._parent = int(job["parent"])
        # Latency is not simulated here: a call takes the time that it takes.
        settings = replace(LoopSettings.from_mapping(job["settings"]), latencies={})
        geometry = BenchGeometry.from_mapping(job["geometry"])
        names = tuple(job["stages"])
        self._health = Health(names, {})
        stages = [build_stage(name, settings, geometry, self._health) for name in names]
        self._own = {stage.output for stage in stages}
        topics = {topic for stage in stages for topic in stage.inputs} - self._own
        self._graph = Graph(stages, self._health, topics)
        self._graph.observers.append(self._send)
        self._wire, keys = Wire(geometry), job["keys"]
        longest, context = self._wire.longest(topics), zmq.Context()
        hidden = {} if keys["publisher"].startswith("ipc:") else keys
        self._inputs = open_socket(context, zmq.SUB, longest, hidden)
        self._outputs = open_socket(context, zmq.PUSH, longest, keys)
        for topic in sorted(topics):
            self._inputs.setsockopt(zmq.SUBSCRIBE, topic.encode() + b"\0")
        self._inputs.connect(keys["publisher"])
        self._outputs.connect(keys["results"])
        self._last_sign: dict[str, Any] = {}
        self._signed = 0.0

    def run(self) -> None:
        """Run until the bench's process has ended."""
        heard = time.monotonic()
        self._sign()
        while time.monotonic() - heard < ORPHANED and os.getppid() == self._parent:
            if self._inputs.poll(round(1000 * SIGN_EVERY / 2)):
                heard = time.monotonic()
                self._receive()
            self._sign()

    def _receive(self) -> None:
        """Receive everything that has arrived, and run the stages on the newest messages."""
        now = self._graph.now
        for frame in arrived(self._inputs):
            topic, message, sent = self._wire.decode(frame.bytes)
            if sent < now - 1.0:  # the bench has begun a new trial
                self._graph.reset()
                now = 0.0
            now = max(now, sent)
            self._graph.publish(topic, message, now)
        self._graph.run_until(now + _NOTHING_LATER, lambda time: None)

    def _send(self, topic: str, message: Message, now: float) -> None:
        if topic not in self._own:
            return
        try:
            self._outputs.send(self._wire.encode(topic, message, now))
        except WireError as error:  # such as a policy's NaN
            self._health.faults[message.stamp.source] = str(error)

    def _sign(self) -> None:
        """Send a sign of life with faults and events, at once when these change."""
        news = {
            "faults": dict(self._health.faults),
            "events": [[one.kind, one.stage, one.reason] for one in self._health.log],
        }
        now = time.monotonic()
        if news == self._last_sign and now - self._signed < SIGN_EVERY:
            return
        self._last_sign, self._signed = {**news, "events": []}, now
        self._health.log.clear()
        # Calls and mean wall-clock seconds of each stage.
        timings = {
            name: [len(seconds), sum(seconds) / max(len(seconds), 1)]
            for name, seconds in self._graph.seconds.items()
        }
        sign = {"stages": timings, **news}
        self._outputs.send(ALIVE + json.dumps(sign).encode())


def main() -> None:
    """Read the job from standard input and run it."""
    from saver_advisors.training.threads import one_thread_of_algebra

    job = json.load(sys.stdin)
    with one_thread_of_algebra():
        Worker(job).run()


if __name__ == "__main__":
    main()
