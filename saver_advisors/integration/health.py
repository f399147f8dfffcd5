"""Who is well: silent, faulty and crashed stages, which of them is the cause, and the log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

#: A topic has fallen silent after so many of its periods.
SILENT_PERIODS: Final = 1.5
#: Before the first results have passed through (s), nobody is called silent; the arms have nothing
#: to do yet.
GRACE: Final = 0.5
_TOLERANCE: Final = 1e-9


@dataclass(frozen=True)
class Event:
    """A line of the log.

    :param time: seconds of the trial
    :param kind: ``stopped``, ``resumed``, ``crashed``, ``restarted``, ``limited`` or ``released``
    :param stage: whom it is about
    :param reason: in words
    """

    time: float
    kind: str
    stage: str
    reason: str

    def __str__(self) -> str:
        return f"{self.time:8.3f} s  {self.kind:<9} {self.stage}: {self.reason}"


@dataclass(frozen=True)
class Cause:
    """Why the arms hold still.

    :param stage: the stage nearest to the camera that is not well
    :param reason: in words
    """

    stage: str
    reason: str

    def __str__(self) -> str:
        return f"{self.stage}: {self.reason}"


class Health:
    """Collects what goes wrong, and names the first cause on the way from camera to servos.

    :param order: names of the stages, sources first
    :param silence: stage -> seconds without a result after which it counts as silent
    """

    def __init__(self, order: Sequence[str], silence: Mapping[str, float]) -> None:
        self._order = tuple(order)
        self._silence = {name: silence[name] for name in order if name in silence}
        self.log: list[Event] = []
        self.reset()

    def reset(self) -> None:
        """Begin a trial."""
        self.log.clear()
        self._faults: dict[str, str] = {}
        self._heard = dict.fromkeys(self._silence, GRACE)

    def heard(self, stage: str, now: float) -> None:
        """Note that a result of a stage has arrived."""
        if stage in self._heard:
            self._heard[stage] = now

    def well(self, stage: str) -> None:
        """Note that a stage has done its work."""
        self._faults.pop(stage, None)

    def fault(self, stage: str, reason: str) -> None:
        """Note why a stage cannot do its work at the moment."""
        self._faults[stage] = reason

    def faults(self) -> dict[str, str]:
        """Why stages cannot do their work at the moment, by stage."""
        return dict(self._faults)

    def note(self, now: float, kind: str, stage: str, reason: str) -> None:
        """Write a line into the log."""
        self.log.append(Event(now, kind, stage, reason))

    def cause(self, now: float) -> Cause | None:
        """The stage nearest to the camera that is faulty or silent, None where all are well.

        A stage that has told its fault is silent for that reason, and what comes after it is
        silent for want of input: none of them is named.
        """
        for stage in self._order:
            if stage in self._faults:
                return Cause(stage, self._faults[stage])
            if stage in self._heard:
                silent = now - self._heard[stage]
                if silent > self._silence[stage] + _TOLERANCE:
                    return Cause(stage, f"nothing for {1000 * silent:.0f} ms")
        return None


def allowed_silence(rate: float, periods: float = SILENT_PERIODS) -> float:
    """Seconds after which a stage that works at a rate (Hz) has fallen silent."""
    return periods / rate
