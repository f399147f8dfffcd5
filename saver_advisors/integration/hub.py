"""The sockets between the bench's process and those of its stages.

The bench's process is in the middle: it publishes what stages elsewhere read, and pulls what they
write. Sockets are bound to this machine alone.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any, Final

from saver_advisors.integration.messages import Message
from saver_advisors.integration.wire import WireError, decode, encode, read_json

HOST: Final = "tcp://127.0.0.1"
#: Messages that may wait for a slow reader; the oldest pictures are of no use to anybody.
WAITING: Final = 16
#: First part of what is a sign of life and no message.
ALIVE: Final = b"!alive"

Arrival = Callable[[str, Message], None]
SignOfLife = Callable[[dict[str, Any]], None]


class Hub:
    """The middle: forwards messages to the stages elsewhere, and hands over theirs.

    :param topics: which are forwarded
    """

    def __init__(self, topics: Collection[str]) -> None:
        import zmq

        self._again = zmq.Again
        self._no_wait = zmq.NOBLOCK
        self._topics = frozenset(topics)
        self._context = zmq.Context()
        self._publisher = self._context.socket(zmq.PUB)
        self._results = self._context.socket(zmq.PULL)
        for socket in (self._publisher, self._results):
            socket.setsockopt(zmq.LINGER, 0)
            socket.set_hwm(WAITING)
        self.publisher_port = int(self._publisher.bind_to_random_port(HOST))
        self.results_port = int(self._results.bind_to_random_port(HOST))
        #: What could not be read, newest last.
        self.refused: list[str] = []

    def forward(self, topic: str, message: Message, now: float) -> None:
        """Send a message to whoever wants its topic; an observer of the graph."""
        if topic in self._topics:
            self._publisher.send_multipart(encode(topic, message, now), copy=True)

    def poll(self, arrival: Arrival, sign_of_life: SignOfLife) -> None:
        """Hand over everything that has come, without waiting.

        :param arrival: gets topic and message
        :param sign_of_life: gets the content of signs of life
        """
        while True:
            try:
                parts = self._results.recv_multipart(self._no_wait)
            except self._again:
                return
            try:
                if parts[0] == ALIVE and len(parts) == 2:
                    sign_of_life(read_json(parts[1]))
                    continue
                topic, message, _ = decode(parts)
            except WireError as error:
                # A stranger's bytes, or a stage of another version: never a reason to fall.
                self.refused = [*self.refused[-9:], str(error)]
                continue
            arrival(topic, message)

    def close(self) -> None:
        """Close both sockets."""
        self._publisher.close()
        self._results.close()
        self._context.term()
