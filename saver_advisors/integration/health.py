"""The health of the stages: faulty and silent ones, the cause of a stop, and the log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

#: A stage counts as silent after this number of its periods.
SILENT_PERIODS: Final = 1.5
#: No stage counts as silent before this time (s): the first results are still on their way, and
#: the arms do not move yet.
GRACE: Final = 0.5
#: Kind of the event that the arms start to hold still.
STOPPED: Final = "stopped"
#: Largest number of lines in the log of a trial.
LONGEST_LOG: Final = 10_000
_TOLERANCE: Final = 1e-9


@dataclass(frozen=True)
class Event:
    """A line of the log.

    :param time: seconds of the trial.
    :param kind: ``stopped``, ``resumed``, ``crashed``, ``restarted`` or ``limited``.
    :param stage: the stage that it is about.
    :param reason: in words.
    """

    time: float
    kind: str
    stage: str
    reason: str

    def __str__(self) -> str:
        return f"{self.time:8.3f} s  {self.kind:<9} {self.stage}: {self.reason}"


class Health:
    """Collect faults and silences, and name the first cause between sensors and servos.

    :param order: names of the stages, sources first.
    :param silence: stage -> seconds without a result after which it counts as silent.
    """

    def __init__(self, order: Sequence[str], silence: Mapping[str, float]) -> None:
        self._order = tuple(order)
        self._silence = {name: silence[name] for name in order if name in silence}
        self.log: list[Event] = []
        self.reset()

    def reset(self) -> None:
        """Begin a trial."""
        self.log.clear()
        #: Why stages fail at present, by stage.
        self.faults: dict[str, str] = {}
        self._heard = dict.fromkeys(self._silence, GRACE)

    def heard(self, stage: str, now: float) -> None:
        """Record that a result of a stage has arrived."""
        if stage in self._heard:
            self._heard[stage] = now

    def note(self, now: float, kind: str, stage: str, reason: str) -> None:
        """Write a line into the log, up to `LONGEST_LOG` of them."""
        if len(self.log) < LONGEST_LOG:
            self.log.append(Event(now, kind, stage, reason))

    def cause(self, now: float) -> Event | None:
        """Return why the arms must hold still: the first stage from the sensors that is faulty or
        silent; None if all are well.

        A faulty stage is silent because of its fault, and the stages after it are silent because
        they get no input, so the first one is the cause.
        """
        for stage in self._order:
            if stage in self.faults:
                return Event(now, STOPPED, stage, self.faults[stage])
            if stage in self._heard:
                silent = now - self._heard[stage]
                if silent > self._silence[stage] + _TOLERANCE:
                    return Event(now, STOPPED, stage, f"nothing for {1000 * silent:.0f} ms")
        return None
