"""The stages of the loop: inputs, output, rate and latency of each, and how a stage fails."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final, TypeVar

from saver_advisors.integration.messages import Message, Stamp

#: Messages of a topic that can be looked up by their number. A pose refers to a picture that is at
#: most a few frames old.
HISTORY: Final = 8
#: Value of ``latency`` that stands for the wall-clock time of the call.
MEASURED: Final = "measured"
Latency = float | str
M = TypeVar("M", bound=Message)


class StageFault(Exception):
    """Signal an input that a stage cannot process; the message states why. The arms hold still.

    A fault is not a crash: the stage continues with its next input.
    """


@dataclass
class Mailbox:
    """Hold the latest visible messages of one topic.

    :param history: the messages, newest last.
    :param arrivals: number of messages received since the trial began.
    """

    history: deque[Message] = field(default_factory=lambda: deque(maxlen=HISTORY))
    arrivals: int = 0

    def put(self, message: Message) -> None:
        """Make a message visible."""
        self.history.append(message)
        self.arrivals += 1

    @property
    def latest(self) -> Message | None:
        """The newest message, None before the first."""
        return self.history[-1] if self.history else None


@dataclass(frozen=True)
class Inputs:
    """Give a stage access to the visible messages.

    :param boxes: topic -> its mailbox.
    """

    boxes: Mapping[str, Mailbox]

    def find(self, topic: str, kind: type[M]) -> M | None:
        """Return the newest message of a topic, None before the first.

        :param topic: name of the topic.
        :param kind: expected class.
        :raises TypeError: for a message of another class.
        """
        message = self.boxes[topic].latest
        if message is None or isinstance(message, kind):
            return message
        raise TypeError(f"topic {topic!r} carries {type(message).__name__}, not {kind.__name__}")

    def latest(self, topic: str, kind: type[M]) -> M:
        """Return the newest message of a topic.

        :param topic: name of the topic.
        :param kind: expected class.
        :raises StageFault: before the first message.
        :raises TypeError: for a message of another class.
        """
        message = self.find(topic, kind)
        if message is None:
            raise StageFault(f"no message on topic {topic!r} yet")
        return message

    def matching(self, topic: str, kind: type[M], sequence: int) -> M:
        """Return the message of a topic that belongs to a given measurement.

        :param topic: name of the topic.
        :param kind: expected class.
        :param sequence: ``stamp.sequence`` of the measurement.
        :raises StageFault: if it is not among the latest `HISTORY` messages.
        """
        for message in reversed(self.boxes[topic].history):
            if message.stamp.sequence == sequence and isinstance(message, kind):
                return message
        raise StageFault(f"message {sequence} of topic {topic!r} is not available")


def check_latency(stage: str, latency: Latency) -> None:
    """Check a latency.

    :param stage: that has it.
    :param latency: seconds, or ``"measured"``.
    :raises ValueError: for another text, or a number that is negative or not finite.
    """
    if isinstance(latency, str):
        if latency != MEASURED:
            raise ValueError(f"latency={latency!r} of {stage!r}: seconds, or {MEASURED!r}")
    elif not 0 <= latency < math.inf:
        raise ValueError(f"latency={latency!r} of {stage!r}: must be 0 s or more")


@dataclass(eq=False)
class LoopStage(ABC):
    """Process messages: one step on the way from the camera to the servos.

    A stage without inputs is a source, which runs at its rate. A stage with inputs runs when the
    first of them is new, at most at its rate if it has one, one message at a time. Messages that
    arrive while it is busy wait, and only the newest of them is processed.

    :param name: name of the stage in logs.
    :param output: topic that it writes.
    :param inputs: topics that it reads; the first one triggers it.
    :param rate: calls per second; required for a source.
    :param latency: seconds between a call and the visibility of its result, or ``"measured"``.
    :raises ValueError: for an invalid rate or latency.
    """

    name: str
    output: str
    inputs: tuple[str, ...] = ()
    rate: float | None = None
    latency: Latency = 0.0

    def __post_init__(self) -> None:
        name, rate = self.name, self.rate
        if rate is None and not self.inputs:
            raise ValueError(f"rate=None: {name!r} has no inputs, so it needs a rate in Hz")
        if rate is not None and not 0 < rate < math.inf:
            raise ValueError(f"rate={rate!r} of {name!r}: must be above 0 Hz")
        check_latency(name, self.latency)

    @abstractmethod
    def process(self, inputs: Inputs, now: float) -> Message | None:
        """Run once.

        :param inputs: the visible messages.
        :param now: time of the trial, seconds.
        :return: the result, or None if there is none this time.
        :raises StageFault: for an input that the stage cannot process.
        """

    def reset(self) -> None:  # noqa: B027  (most stages have no state)
        """Clear the state, at the start of a trial and after a crash."""

    def stamp(self, of: Stamp) -> Stamp:
        """Return the stamp of a result that is computed from a message with stamp ``of``."""
        return Stamp(of.time, of.sequence, self.name)


#: Replaces stages of a loop; receives all of them in order and returns the new list.
Change = Callable[[list[LoopStage]], list[LoopStage]]


@dataclass(eq=False)
class SensorStage(LoopStage):
    """Read a sensor at a fixed rate, and number its measurements from 1.

    :param measure: returns a message with the stamp that it is passed.
    """

    measure: Callable[[Stamp], Message] = field(kw_only=True)
    _sequence: int = field(default=0, init=False)

    def reset(self) -> None:
        """Restart the numbering."""
        self._sequence = 0

    def process(self, inputs: Inputs, now: float) -> Message:
        """Read the sensor once."""
        self._sequence += 1
        return self.measure(Stamp(now, self._sequence, self.name))
