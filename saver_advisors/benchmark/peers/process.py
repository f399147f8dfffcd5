"""A peer's program in a process of its own: a line in, a line of JSON out."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from pathlib import Path
from typing import Any, Final, Self

#: Linear algebra of a peer takes one thread, as ours does where the two are compared.
_ONE_THREAD: Final = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)


class PeerError(Exception):
    """A peer that cannot be installed or does not run."""


class PeerProcess:
    """A worker's process, idle until it is asked; a context manager.

    It inherits the processor cores of the caller.

    :param name: of the peer, for messages
    :param python: of its virtual environment
    :param worker: its program, which answers once when it is ready
    :param arguments: of the program
    """

    def __init__(self, name: str, python: Path, worker: Path, *arguments: str) -> None:
        self.name = name
        self._log = tempfile.TemporaryFile("w+", encoding="utf-8")  # noqa: SIM115  (closed at exit)
        self._process = subprocess.Popen(
            [str(python), "-W", "ignore", str(worker), *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
            env={**os.environ, **_ONE_THREAD},
        )

    def ask(self, line: str) -> Any:
        """Hand over a line and wait for the answer.

        :param line: without its line break
        :return: what the answer's JSON says
        :raises PeerError: when the process ends instead
        """
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()
        return self.read()

    def read(self) -> Any:
        """Wait for an answer.

        :return: what its JSON says
        :raises PeerError: when the process ends instead
        """
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            self._log.seek(0)
            last = self._log.read().strip().splitlines()[-1:]
            raise PeerError(f"{self.name} does not run: {' '.join(last)}")
        return json.loads(line)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._process.kill()
        self._process.communicate()
        self._log.close()
