"""The sockets between the bench's process and the processes of its stages.

The bench's process is the hub: it publishes the messages that remote stages read, and pulls the
ones that they write. Sockets are bound to this machine alone.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterator
from typing import Any, Final

import zmq

from saver_advisors.integration.messages import Message
from saver_advisors.integration.wire import WireError, decode, encode, read_json

HOST: Final = "tcp://127.0.0.1"
#: Largest number of messages that wait for a slow reader, since old pictures are useless.
WAITING: Final = 16
#: First part of a sign of life, which is not a message.
ALIVE: Final = b"!alive"


def open_socket(context: zmq.Context[Any], kind: int) -> zmq.Socket[bytes]:
    """Open a socket that keeps few messages and closes at once.

    :param context: of the process.
    :param kind: such as ``zmq.PUB``.
    """
    socket = context.socket(kind)
    socket.setsockopt(zmq.LINGER, 0)
    socket.set_hwm(WAITING)
    return socket


class Hub:
    """Forward messages to remote stages, and receive theirs.

    :param topics: that are forwarded.
    """

    def __init__(self, topics: Collection[str]) -> None:
        self._topics = frozenset(topics)
        self._context = zmq.Context()
        self._publisher = open_socket(self._context, zmq.PUB)
        self._results = open_socket(self._context, zmq.PULL)
        self.publisher_port = int(self._publisher.bind_to_random_port(HOST))
        self.results_port = int(self._results.bind_to_random_port(HOST))
        #: Errors of the last ten messages that could not be decoded, newest last.
        self.refused: deque[str] = deque(maxlen=10)

    def forward(self, topic: str, message: Message, now: float) -> None:
        """Send a message to the subscribers of its topic; an observer of the graph."""
        if topic in self._topics:
            self._publisher.send_multipart(encode(topic, message, now), copy=True)

    def received(
        self, sign_of_life: Callable[[dict[str, Any]], None]
    ) -> Iterator[tuple[str, Message]]:
        """Yield topic and message of everything that has arrived, without waiting.

        :param sign_of_life: called with the content of each sign of life.
        """
        while self._results.poll(0):
            parts = self._results.recv_multipart()
            try:
                if parts[0] == ALIVE and len(parts) == 2:
                    sign_of_life(read_json(parts[1]))
                else:
                    yield decode(parts)[:2]
            except WireError as error:
                # Third-party bytes, or a stage of another version, must not end the loop.
                self.refused.append(str(error))

    def close(self) -> None:
        """Close both sockets."""
        self._publisher.close()
        self._results.close()
        self._context.term()
