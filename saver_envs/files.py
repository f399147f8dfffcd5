"""Atomic writing of files, and reading of JSON."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO


@contextmanager
def written_whole(path: str | Path) -> Iterator[BinaryIO]:
    """Open a file for atomic writing: it gets its name once it is complete and on the disk.

    The data goes to a temporary file in the same folder first, so a crash, a full disk or another
    process that writes the same file never leaves an incomplete file.

    :param path: of the file; its folder must exist.
    :return: a context with the file opened for binary writing; an exception inside leaves an old
        file as it was.
    :raises OSError: when it cannot be written, naming the file; an old file is then intact.
    """
    path = Path(path)
    partial = path.with_name(f"{path.name}.{os.getpid()}.partial")
    try:
        with open(partial, "wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except OSError as error:
        reason = error.strerror or error
        raise OSError(error.errno, f"{path} could not be written ({reason})") from error
    finally:
        partial.unlink(missing_ok=True)


def cache_folder(name: str) -> Path:
    """Return a folder of this project in the user's cache folder; it may not exist yet.

    :param name: of the folder.
    """
    root = os.environ.get("XDG_CACHE_HOME")
    return (Path(root) if root else Path.home() / ".cache") / "saver-envs" / name


def read_json(path: str | Path) -> Any:
    """Read a JSON file.

    :param path: of the file.
    :return: its content.
    :raises ValueError: if it is not JSON, or nested too deeply; the message names it.
    :raises OSError: if it cannot be read.
    """
    try:
        return json.loads(Path(path).read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} is truncated or not JSON: {error}") from error
