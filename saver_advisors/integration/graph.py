"""The graph of stages on the simulation's clock: who works when, and when others see the result."""

from __future__ import annotations

import heapq
import math
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from itertools import count
from typing import Final, Protocol

from saver_advisors.integration.health import Health
from saver_advisors.integration.messages import Message
from saver_advisors.integration.stage import Inputs, Mailbox, Stage, StageFault

#: A stage that crashed is started again after this (s).
RESTART_AFTER: Final = 0.2
_TOLERANCE: Final = 1e-9


class Plant(Protocol):
    """What the graph's clock moves on."""

    def advance_to(self, time: float) -> None:
        """Simulate up to a time, seconds of the trial."""


class Observer(Protocol):
    """Who watches messages as they become visible, such as a recorder."""

    def __call__(self, topic: str, message: Message, now: float) -> None:
        """Look at a message."""


@dataclass
class Timing:
    """How a stage has worked so far.

    :param calls: how often
    :param results: how often with a result
    :param seconds: wall-clock time of each call
    """

    calls: int = 0
    results: int = 0
    seconds: list[float] = field(default_factory=list)


@dataclass
class _Schedule:
    """When a stage may work next.

    :param due: a source's next time, or the earliest that a rate allows
    :param busy_until: end of the work at hand
    :param seen: arrivals on the first input that were worked on
    :param down_until: a crashed stage is started again then
    """

    due: float = 0.0
    busy_until: float = 0.0
    seen: int = 0
    down_until: float = -math.inf


class Graph:
    """Stages joined by topics.

    Stages that are due at the same time work in the order in which they are given, so that a chain
    without latency is passed through at once.

    :param stages: on the way from the sensors to the servos
    :param external: topics that are filled from outside, by :meth:`publish`
    :param health: where faults are noted
    :raises ValueError: for two stages of one name or output, or an input that nobody writes
    """

    def __init__(
        self, stages: Sequence[Stage], health: Health, external: Collection[str] = ()
    ) -> None:
        _check(stages, external)
        self.stages = tuple(stages)
        self.health = health
        topics = [*(stage.output for stage in stages), *external]
        self.boxes = {topic: Mailbox() for topic in topics}
        self.timings = {stage.name: Timing() for stage in stages}
        self.observers: list[Observer] = []
        self._maker = {stage.output: stage.name for stage in stages}
        self._inputs = Inputs(self.boxes)
        self.reset()

    def reset(self) -> None:
        """Begin a trial at time 0; timings are kept."""
        self.now = 0.0
        self._numbers = count()
        self._waiting: list[tuple[float, int, str, Message]] = []
        self._schedules = {stage.name: _Schedule() for stage in self.stages}
        for box in self.boxes.values():
            box.history.clear()
            box.arrivals, box.arrived = 0, -math.inf
        for stage in self.stages:
            stage.reset()
        self.health.reset()

    def publish(self, topic: str, message: Message, visible: float) -> None:
        """Let a message be seen from a time on."""
        heapq.heappush(self._waiting, (visible, next(self._numbers), topic, message))

    def run_until(self, end: float, plant: Plant) -> None:
        """Let time pass: the plant moves, stages work as they become due.

        :param end: seconds of the trial; what is due at that very time is left to the next call
        :param plant: brought to each moment before the stages of that moment work
        """
        while True:
            moment = self._next_moment()
            if moment >= end - _TOLERANCE:
                break
            self.now = max(self.now, moment)
            plant.advance_to(self.now)
            self._deliver()
            for stage in self.stages:
                if self._ready(stage) <= self.now + _TOLERANCE:
                    self._work(stage)
        self.now = end
        plant.advance_to(end)

    def _next_moment(self) -> float:
        moment = self._waiting[0][0] if self._waiting else math.inf
        return min(moment, min(map(self._ready, self.stages)))

    def _ready(self, stage: Stage) -> float:
        """When a stage can work next, as far as is known."""
        schedule = self._schedules[stage.name]
        if stage.inputs and self.boxes[stage.inputs[0]].arrivals == schedule.seen:
            return math.inf
        return max(schedule.due, schedule.busy_until, schedule.down_until)

    def _deliver(self) -> None:
        while self._waiting and self._waiting[0][0] <= self.now + _TOLERANCE:
            _, _, topic, message = heapq.heappop(self._waiting)
            self._show(topic, message)

    def _show(self, topic: str, message: Message) -> None:
        self.boxes[topic].put(message, self.now)
        self.health.heard(self._maker.get(topic, message.stamp.source), self.now)
        for observer in self.observers:
            observer(topic, message, self.now)

    def _work(self, stage: Stage) -> None:
        schedule, timing = self._schedules[stage.name], self.timings[stage.name]
        if schedule.down_until > 0:  # was down until now
            schedule.down_until = -math.inf
            stage.reset()
            self.health.note(self.now, "restarted", stage.name, "started again")
        if stage.inputs:
            schedule.seen = self.boxes[stage.inputs[0]].arrivals
        if stage.rate is not None:
            # The next place on a grid through 0, so that rounding does not add up.
            schedule.due = (math.floor(self.now * stage.rate + 1e-6) + 1) / stage.rate
        begin = time.perf_counter()
        message = self._attempt(stage)
        took = time.perf_counter() - begin
        timing.calls += 1
        timing.seconds.append(took)
        latency = took if isinstance(stage.latency, str) else stage.latency
        schedule.busy_until = self.now + latency
        if message is None:
            return
        timing.results += 1
        if latency <= _TOLERANCE:
            self._show(stage.output, message)
        else:
            self.publish(stage.output, message, self.now + latency)

    def _attempt(self, stage: Stage) -> Message | None:
        """Let a stage work; whatever happens inside must not end the loop that holds the arms."""
        try:
            message = stage.process(self._inputs, self.now)
        except StageFault as fault:
            self.health.fault(stage.name, str(fault))
        except Exception as error:
            reason = f"crashed: {type(error).__name__}: {error}"
            self.health.fault(stage.name, reason)
            self.health.note(self.now, "crashed", stage.name, reason)
            self._schedules[stage.name].down_until = self.now + RESTART_AFTER
        else:
            self.health.well(stage.name)
            return message
        return None


def _check(stages: Sequence[Stage], external: Collection[str]) -> None:
    for what in ("name", "output"):
        values = [getattr(stage, what) for stage in stages]
        twice = sorted({value for value in values if values.count(value) > 1})
        if twice:
            raise ValueError(f"stages: {what} {twice[0]!r} is used twice")
    topics = {stage.output for stage in stages} | set(external)
    for stage in stages:
        for topic in stage.inputs:
            if topic not in topics:
                raise ValueError(
                    f"stage {stage.name!r} reads {topic!r}, which nobody writes; there are "
                    f"{', '.join(sorted(topics))}"
                )
