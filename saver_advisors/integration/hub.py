"""The sockets between the bench's process and the processes of its stages.

The bench's process is the hub: it publishes the messages that remote stages read, and pulls the
ones that they write. Both sockets are files in a folder that only this user can open. The one for
results is encrypted with CURVE keys that are made for the run: the key of a process states which
topics it may write. So is the publisher where sockets cannot be files; encryption costs 8 ms a
picture.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping
from tempfile import TemporaryDirectory
from typing import Any, Final

import zmq
from zmq.auth.thread import ThreadAuthenticator

from saver_advisors.integration.messages import Message
from saver_advisors.integration.wire import SignOfLife, Wire, WireError

#: Largest number of messages that wait for a slow reader, since old pictures are useless.
WAITING: Final = 16
#: Largest number of messages that are read at once, so that a flood does not stop the bench.
AT_ONCE: Final = 64
#: Begin of a sign of life, which is not a message.
ALIVE: Final = b"!alive\0"


def open_socket(
    context: zmq.Context[Any], kind: int, longest: int, keys: Mapping[str, str]
) -> zmq.Socket[bytes]:
    """Open a socket that keeps few messages and closes at once.

    :param context: of the process.
    :param kind: such as ``zmq.PUB``.
    :param longest: bytes of a message; a peer that sends more is disconnected.
    :param keys: ``public`` and ``secret``, and ``server`` for the socket of a client; empty for a
        socket that is not encrypted.
    """
    socket = context.socket(kind)
    socket.setsockopt(zmq.LINGER, 0)
    socket.setsockopt(zmq.MAXMSGSIZE, longest)
    socket.set_hwm(WAITING)
    if not keys:
        return socket
    socket.curve_publickey = keys["public"].encode()
    socket.curve_secretkey = keys["secret"].encode()
    if "server" in keys:
        socket.curve_serverkey = keys["server"].encode()
    else:
        socket.curve_server = True
    return socket


def arrived(socket: zmq.Socket[bytes]) -> Iterator[zmq.Frame]:
    """Yield what has arrived at a socket, at most `AT_ONCE` messages, without waiting."""
    for _ in range(AT_ONCE):
        try:  # polling would now and then announce a message that does not come
            frame = socket.recv(zmq.NOBLOCK, copy=False)
        except zmq.Again:
            return
        yield frame


def _new_keys() -> dict[str, str]:
    public, secret = zmq.curve_keypair()
    return {"public": public.decode(), "secret": secret.decode()}


class Hub:
    """Forward messages to remote stages, and receive theirs.

    :param wire: encodes and decodes messages.
    :param forwarded: topics that remote stages may read.
    :param received: topics that they write.
    """

    def __init__(self, wire: Wire, forwarded: Collection[str], received: Collection[str]) -> None:
        self._wire = wire
        self._forwarded = frozenset(forwarded)
        self._owners: dict[str, Mapping[str, str]] = {}
        self._folder = TemporaryDirectory(prefix="saver-")  # mode 0700
        self._context = zmq.Context()
        self._keys = _new_keys()
        self._guard = ThreadAuthenticator(self._context)
        self._guard.configure_curve_callback(credentials_provider=self)
        self._guard.start()
        longest = wire.longest(received)
        hidden = {} if zmq.has("ipc") else self._keys
        self._publisher = open_socket(self._context, zmq.PUB, longest, hidden)
        self._results = open_socket(self._context, zmq.PULL, longest, self._keys)
        self._addresses = {
            "publisher": self._bound(self._publisher, "publisher"),
            "results": self._bound(self._results, "results"),
        }
        #: Errors of the last ten messages that were refused, newest last.
        self.refused: deque[str] = deque(maxlen=10)

    def _bound(self, socket: zmq.Socket[bytes], name: str) -> str:
        # Windows' ZeroMQ has no files as addresses; the keys protect the port.
        file = f"ipc://{self._folder.name}/{name}"
        socket.bind(file if zmq.has("ipc") else "tcp://127.0.0.1:*")
        return bytes(socket.getsockopt(zmq.LAST_ENDPOINT)).decode().rstrip("\0")

    def admit(self, owned: Mapping[str, str]) -> dict[str, str]:
        """Make the keys of a process, with which it may connect.

        :param owned: topic -> stage, of the topics that it may write.
        :return: its keys, and the addresses of the sockets; secret.
        """
        keys = _new_keys()
        self._owners[keys["public"]] = dict(owned)
        return {**keys, "server": self._keys["public"], **self._addresses}

    def expel(self, public_key: str) -> None:
        """Accept nothing more from a process."""
        self._owners.pop(public_key, None)

    def callback(self, domain: str, key: bytes) -> bool:
        """Return whether the owner of a key may connect; ZeroMQ's authenticator calls this."""
        return key.decode() in self._owners

    def forward(self, topic: str, message: Message, now: float) -> None:
        """Send a message to the subscribers of its topic; an observer of the graph."""
        if topic in self._forwarded:
            try:
                self._publisher.send(self._wire.encode(topic, message, now))
            except WireError as error:  # such as NaN of a diverged simulation
                self.refused.append(str(error))

    def received(
        self, sign_of_life: Callable[[str, SignOfLife], None]
    ) -> Iterator[tuple[str, Message]]:
        """Yield topic and message of what has arrived, without waiting.

        :param sign_of_life: called with the public key of the sender and each sign of life.
        """
        for frame in arrived(self._results):
            key, content = str(frame.get("User-Id")), frame.bytes
            try:
                if content.startswith(ALIVE):
                    sign_of_life(key, SignOfLife.read(content.removeprefix(ALIVE)))
                else:
                    topic, message, _ = self._wire.decode(content)
                    if self._owners.get(key, {}).get(topic) != message.stamp.source:
                        raise WireError(f"{topic!r} of {message.stamp.source!r}: not the owner")
                    yield topic, message
            except WireError as error:
                # A stage of another version, or one that was taken over, must not end the loop.
                self.refused.append(str(error))

    def close(self) -> None:
        """Close both sockets, and remove their folder."""
        self._publisher.close()
        self._results.close()
        self._guard.stop()
        self._context.term()
        self._folder.cleanup()
