"""Measure the time of a program by part, by wrapping methods of its objects."""

from __future__ import annotations

import functools
import time
from typing import Any


class Stopwatch:
    """Adds up the processor time of each watched method.

    Time that a watched method spends in another one counts for the latter only, so that the parts
    add up to the whole.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._running: list[str] = []
        self._since = 0.0

    def watch(self, owner: Any, method: str, part: str) -> None:
        """Time a method of one object from now on.

        :param owner: the object, whose attributes must be settable.
        :param method: name of the method.
        :param part: the part that its time counts for.
        :raises AttributeError: if the object has no such method.
        """
        inner = getattr(owner, method)
        self.seconds.setdefault(part, 0.0)

        @functools.wraps(inner)
        def timed(*arguments: Any, **named: Any) -> Any:
            self._lap()
            self._running.append(part)
            try:
                return inner(*arguments, **named)
            finally:
                self._lap()
                self._running.pop()

        setattr(owner, method, timed)

    def take(self) -> dict[str, float]:
        """Return the seconds of each part since the last call, and start again at 0."""
        taken = dict(self.seconds)
        self.seconds = dict.fromkeys(taken, 0.0)
        return taken

    def _lap(self) -> None:
        """Add the time since the last lap to the part that is running."""
        now = time.process_time()
        if self._running:
            self.seconds[self._running[-1]] += now - self._since
        self._since = now
