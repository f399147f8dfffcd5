"""Run a peer's program in its own process: a line in, a line of JSON out."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from pathlib import Path
from typing import Any, Final, Self

#: Restrict a peer's linear algebra to one thread, as ours in comparisons.
_ONE_THREAD: Final = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)


class PeerError(Exception):
    """Report a peer that cannot be installed or does not run."""


def run_quietly(command: list[str], failure: str) -> None:
    """Run a command without showing its output.

    :param command: program and arguments
    :param failure: start of the error message
    :raises PeerError: if the command fails, with the last line of its output
    """
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        last = (done.stderr or done.stdout).strip().splitlines()[-1:]
        raise PeerError(f"{failure}: {' '.join(last)}")


class PeerProcess:
    """A process that answers requests; a context manager.

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
        """Send a line and wait for the answer.

        :param line: without its line break
        :return: the parsed answer
        :raises PeerError: if the process ends
        """
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()
        return self.read()

    def read(self) -> Any:
        """Wait for an answer.

        :return: the parsed answer
        :raises PeerError: if the process ends
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
