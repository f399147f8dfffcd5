"""What a stage is: a name, what it reads and writes, how often, how late; and how it fails."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from dataclasses import dataclass, field
from typing import Final, TypeVar

from saver_advisors.integration.messages import Message, Stamp

#: Messages of a topic that can be looked up by their number; a picture has come and gone within
#: a handful of frames.
HISTORY: Final = 8
#: Latency that is as long as the call took on this machine.
MEASURED: Final = "measured"
Latency = float | str
M = TypeVar("M", bound=Message)


class StageFault(Exception):
    """An input that a stage can make nothing of; its message says why. The arms hold still.

    It is no crash: the stage goes on with its next input.
    """


@dataclass
class Mailbox:
    """The newest messages of one topic that can be seen."""

    history: deque[Message] = field(default_factory=lambda: deque(maxlen=HISTORY))
    arrivals: int = 0
    arrived: float = -math.inf

    def put(self, message: Message, now: float) -> None:
        """Let a message be seen from now on."""
        self.history.append(message)
        self.arrivals += 1
        self.arrived = now

    @property
    def latest(self) -> Message | None:
        """The newest one, None before the first."""
        return self.history[-1] if self.history else None


class Inputs:
    """What a stage can see now.

    :param boxes: topic -> its messages
    """

    def __init__(self, boxes: dict[str, Mailbox]) -> None:
        self._boxes = boxes

    def find(self, topic: str, kind: type[M]) -> M | None:
        """The newest message of a topic, None before the first.

        :raises TypeError: where it is of another kind
        """
        return _checked(topic, self._boxes[topic].latest, kind)

    def latest(self, topic: str, kind: type[M]) -> M:
        """The newest message of a topic.

        :raises StageFault: before the first
        :raises TypeError: where it is of another kind
        """
        message = self.find(topic, kind)
        if message is None:
            raise StageFault(f"nothing has come from {topic!r} yet")
        return message

    def matching(self, topic: str, kind: type[M], sequence: int) -> M:
        """The message of a topic that tells of a given measurement.

        :param topic: its name
        :param kind: its class
        :param sequence: ``stamp.sequence`` to look for
        :raises StageFault: where it is not among the newest ones any more, or yet
        """
        for message in reversed(self._boxes[topic].history):
            if message.stamp.sequence == sequence:
                found = _checked(topic, message, kind)
                assert found is not None
                return found
        raise StageFault(f"number {sequence} of {topic!r} is not at hand")


def _checked(topic: str, message: Message | None, kind: type[M]) -> M | None:
    if message is None or isinstance(message, kind):
        return message
    raise TypeError(f"topic {topic!r} carries {type(message).__name__}, not {kind.__name__}")


class Stage(ABC):
    """One step of the way from the camera to the servos.

    Without inputs it is a source, which works at its rate. With inputs it works when the first of
    them is new, at most at its rate where it has one, one message at a time: what comes while it
    is busy waits, and of what waits only the newest counts.

    :param name: of the stage, by which logs call it
    :param output: topic that its messages appear under
    :param inputs: topics that it reads, the one that sets it off first
    :param rate: calls per second; needed by a source
    :param latency: seconds from a call to when others see its result, or ``"measured"``
    :raises ValueError: for a rate or latency that cannot be
    """

    def __init__(
        self,
        name: str,
        output: str,
        inputs: tuple[str, ...] = (),
        rate: float | None = None,
        latency: Latency = 0.0,
    ) -> None:
        if rate is None and not inputs:
            raise ValueError(f"rate=None: {name!r} has no inputs, so it needs a rate in Hz")
        if rate is not None and not 0 < rate < math.inf:
            raise ValueError(f"rate={rate!r} of {name!r}: must be above 0 Hz")
        if isinstance(latency, str):
            if latency != MEASURED:
                raise ValueError(f"latency={latency!r} of {name!r}: seconds, or {MEASURED!r}")
        elif not 0 <= latency < math.inf:
            raise ValueError(f"latency={latency!r} of {name!r}: must be 0 s or more")
        self.name = name
        self.output = output
        self.inputs = inputs
        self.rate = rate
        self.latency = latency

    @abstractmethod
    def process(self, inputs: Inputs, now: float) -> Message | None:
        """Work once.

        :param inputs: what can be seen
        :param now: seconds of the trial
        :return: the result, or None where there is none this time
        :raises StageFault: for an input that it can make nothing of
        """

    def reset(self) -> None:  # noqa: B027  (most stages have nothing to forget)
        """Forget everything: a trial begins, or the stage was restarted after a crash."""

    def stamp(self, of: Stamp) -> Stamp:
        """The stamp of a result of this stage, computed from a message with stamp ``of``."""
        return Stamp(of.time, of.sequence, self.name)
