"""The folder of a run: its record, ``run.json``, and the lock of the process that trains in it."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from saver_envs.files import read_json

RECORD_FILE: Final = "run.json"
LOCK_FILE: Final = ".lock"
OWNER_FILE: Final = ".lock-owner"


class FolderInUseError(OSError):
    """Another process trains in the folder of a run."""


def read_record(folder: str | Path) -> dict[str, Any]:
    """Read the record of a run.

    :param folder: the run's folder.
    :return: ``config``, fields of ``RunConfig``, and ``sessions``, a mapping for each.
    :raises ValueError: if it is not one; the message names the file.
    :raises OSError: if it cannot be read.
    """
    path = Path(folder) / RECORD_FILE
    record = read_json(path)
    try:
        sessions = [dict(session) for session in record["sessions"]]
        return {**record, "config": dict(record["config"]), "sessions": sessions}
    except (LookupError, TypeError, ValueError) as error:
        raise ValueError(f"{path} is not the record of a run: {error!r}") from error


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep other processes from training in a folder; one thread may lock it repeatedly.

    The operating system releases the lock when the process ends, however it does.

    :param folder: of the run; created if missing.
    :raises FolderInUseError: if another process or thread has the lock; the message names both.
    :raises OSError: if the folder cannot be written to.
    """
    from filelock import FileLock, Timeout

    owner = folder / OWNER_FILE
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(folder / LOCK_FILE, is_singleton=True)
        lock.acquire(blocking=False)
    except Timeout as error:
        name = owner.read_text(encoding="utf-8") if owner.is_file() else "another process"
        raise FolderInUseError(
            f"{folder} is in use by {name}: wait until it ends, or choose another folder"
        ) from error
    except OSError as error:
        raise OSError(error.errno, f"{folder} cannot be written to ({error.strerror})") from error
    outermost = lock.lock_counter == 1
    try:
        if outermost:
            owner.write_text(f"process {os.getpid()} on {platform.node()}", encoding="utf-8")
        yield
    finally:
        if outermost:
            owner.unlink(missing_ok=True)
        lock.release()
