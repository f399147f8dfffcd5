"""Requests to stop, by signals or a time limit."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager


class Stop:
    """A request to stop, by Ctrl-C, SIGTERM or a time limit; true once it is made.

    :param seconds: the time limit, or None
    """

    def __init__(self, seconds: float | None = None) -> None:
        self._asked = False
        self._deadline = None if seconds is None else time.monotonic() + seconds

    def __bool__(self) -> bool:
        late = self._deadline is not None and time.monotonic() >= self._deadline
        return late or self._asked

    @contextmanager
    def on_signals(self, words: str = "") -> Iterator[None]:
        """Treat Ctrl-C and SIGTERM as requests; a second Ctrl-C ends the program at once.

        :param words: printed at a request
        """
        if threading.current_thread() is not threading.main_thread():
            # Python delivers signals to the main thread only, which then decides.
            yield
            return

        def request(number: int, frame: object) -> None:
            if self._asked and number == signal.SIGINT:
                raise KeyboardInterrupt
            self._asked = True
            if words:
                print(words, file=sys.stderr)

        numbers = (signal.SIGINT, signal.SIGTERM)
        handlers = {number: signal.signal(number, request) for number in numbers}
        try:
            yield
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)
