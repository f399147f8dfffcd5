"""The graph of stages on a simulated clock: when stages run, and when results are visible."""

from __future__ import annotations

import heapq
import math
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from itertools import count
from typing import Final

from saver_advisors.integration.health import Health
from saver_advisors.integration.messages import Message
from saver_advisors.integration.stage import Inputs, LoopStage, Mailbox, StageFault

#: Delay before a crashed stage is restarted (s).
RESTART_AFTER: Final = 0.2
_TOLERANCE: Final = 1e-9
#: Called with topic, message and time when a message becomes visible, such as a recorder.
Observer = Callable[[str, Message, float], None]


@dataclass
class _Schedule:
    """When a stage may run next.

    :param due: next time of a source, or the earliest time that a rate allows.
    :param busy_until: end of the present call.
    :param seen: number of arrivals on the first input at the last call.
    :param down_until: time at which a crashed stage is restarted.
    """

    due: float = 0.0
    busy_until: float = 0.0
    seen: int = 0
    down_until: float = -math.inf


class Graph:
    """Connect stages by topics.

    Stages that are due at the same time run in the given order, so that a chain without latency
    is processed at once.

    :param stages: in order, from the sensors to the servos.
    :param health: records faults.
    :param external: topics that :meth:`publish` fills from outside.
    :raises ValueError: for two stages with one name or output, or an input without a writer.
    """

    def __init__(
        self, stages: Sequence[LoopStage], health: Health, external: Collection[str] = ()
    ) -> None:
        _check(stages, external)
        self.stages = tuple(stages)
        self.health = health
        self._topics = (*(stage.output for stage in stages), *external)
        #: Wall-clock seconds of each call, by stage.
        self.seconds: dict[str, list[float]] = {stage.name: [] for stage in stages}
        self.observers: list[Observer] = []
        self._maker = {stage.output: stage.name for stage in stages}
        self.reset()

    def reset(self) -> None:
        """Begin a trial at time 0; durations are kept."""
        self.now = 0.0
        self._numbers = count()
        self._waiting: list[tuple[float, int, str, Message]] = []
        self._schedules = {stage.name: _Schedule() for stage in self.stages}
        self.boxes = {topic: Mailbox() for topic in self._topics}
        self._inputs = Inputs(self.boxes)
        for stage in self.stages:
            stage.reset()
        self.health.reset()

    def publish(self, topic: str, message: Message, visible: float) -> None:
        """Make a message visible at a time, seconds of the trial."""
        heapq.heappush(self._waiting, (visible, next(self._numbers), topic, message))

    def run_until(self, end: float, advance_to: Callable[[float], object]) -> None:
        """Run the bench and the stages up to a time.

        :param end: seconds of the trial; stages that are due at this time run in the next call.
        :param advance_to: advances the bench to each moment before the stages of that moment run.
        """
        while (moment := self._next_moment()) < end - _TOLERANCE:
            self.now = max(self.now, moment)
            advance_to(self.now)
            while self._waiting and self._waiting[0][0] <= self.now + _TOLERANCE:
                _, _, topic, message = heapq.heappop(self._waiting)
                self._show(topic, message)
            for stage in self.stages:
                if self._ready(stage) <= self.now + _TOLERANCE:
                    self._run(stage)
        self.now = end
        advance_to(end)

    def _next_moment(self) -> float:
        moment = self._waiting[0][0] if self._waiting else math.inf
        return min(moment, min(map(self._ready, self.stages)))

    def _ready(self, stage: LoopStage) -> float:
        """Return when a stage can run next, as far as is known."""
        schedule = self._schedules[stage.name]
        if stage.inputs and self.boxes[stage.inputs[0]].arrivals == schedule.seen:
            return math.inf
        return max(schedule.due, schedule.busy_until, schedule.down_until)

    def _show(self, topic: str, message: Message) -> None:
        self.boxes[topic].put(message)
        self.health.heard(self._maker.get(topic, message.stamp.source), self.now)
        for observer in self.observers:
            observer(topic, message, self.now)

    def _run(self, stage: LoopStage) -> None:
        schedule = self._schedules[stage.name]
        if schedule.down_until > 0:  # was down until now
            schedule.down_until = -math.inf
            stage.reset()
            self.health.note(self.now, "restarted", stage.name, "started again")
        if stage.inputs:
            schedule.seen = self.boxes[stage.inputs[0]].arrivals
        if stage.rate is not None:
            # The next point of a grid through 0, so that rounding errors do not accumulate.
            schedule.due = (math.floor(self.now * stage.rate + 1e-6) + 1) / stage.rate
        begin = time.perf_counter()
        message = self._attempt(stage)
        took = time.perf_counter() - begin
        self.seconds[stage.name].append(took)
        latency = took if isinstance(stage.latency, str) else stage.latency
        schedule.busy_until = self.now + latency
        if message is None:
            return
        if latency <= _TOLERANCE:
            self._show(stage.output, message)
        else:
            self.publish(stage.output, message, self.now + latency)

    def _attempt(self, stage: LoopStage) -> Message | None:
        """Call a stage; no exception may end the loop that holds the arms."""
        try:
            message = stage.process(self._inputs, self.now)
        except StageFault as fault:
            self.health.faults[stage.name] = str(fault)
        except Exception as error:
            reason = f"crashed: {type(error).__name__}: {error}"
            self.health.faults[stage.name] = reason
            self.health.note(self.now, "crashed", stage.name, reason)
            self._schedules[stage.name].down_until = self.now + RESTART_AFTER
        else:
            self.health.faults.pop(stage.name, None)
            return message
        return None


def _check(stages: Sequence[LoopStage], external: Collection[str]) -> None:
    for what in ("name", "output"):
        values = [getattr(stage, what) for stage in stages]
        twice = sorted({value for value in values if values.count(value) > 1})
        if twice:
            raise ValueError(f"stages: {what} {twice[0]!r} is used twice")
    topics = {*(stage.output for stage in stages), *external}
    for stage in stages:
        for topic in stage.inputs:
            if topic not in topics:
                raise ValueError(
                    f"stage {stage.name!r} reads {topic!r}, which no stage writes; there are "
                    f"{', '.join(sorted(topics))}"
                )
