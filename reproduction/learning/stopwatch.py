"""Time by part of a program, from outside: methods of objects are wrapped, nothing is edited."""

from __future__ import annotations

import functools
import time
from typing import Any


class Stopwatch:
    """Adds up the processor time that each watched method takes itself.

    What a watched method spends in another watched one counts for the latter alone, so that the
    parts add up to the whole.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._running: list[str] = []
        self._since = 0.0

    def watch(self, owner: Any, method: str, part: str) -> None:
        """Time a method of one object from now on.

        :param owner: the object, which must let its attributes be set
        :param method: its name
        :param part: what its time counts for
        :raises AttributeError: where the object has no such method
        """
        inner = getattr(owner, method)
        self.seconds.setdefault(part, 0.0)

        @functools.wraps(inner)
        def timed(*arguments: Any, **named: Any) -> Any:
            self._switch(part)
            try:
                return inner(*arguments, **named)
            finally:
                self._back()

        setattr(owner, method, timed)

    def take(self) -> dict[str, float]:
        """The seconds of each part since the last call, which starts them at 0 again."""
        taken = dict(self.seconds)
        self.seconds = dict.fromkeys(taken, 0.0)
        return taken

    def _switch(self, part: str) -> None:
        now = time.process_time()
        if self._running:
            self.seconds[self._running[-1]] += now - self._since
        self._running.append(part)
        self._since = now

    def _back(self) -> None:
        now = time.process_time()
        self.seconds[self._running.pop()] += now - self._since
        self._since = now
