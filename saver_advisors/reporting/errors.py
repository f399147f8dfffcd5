"""Mistakes of the user's: one line with the argument, the value, and what would be right."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager


class UsageError(Exception):
    """Something that the user can put right; shown as one line, without a traceback."""


@contextmanager
def user_mistakes(argument: str = "") -> Iterator[None]:
    """Turn the errors that our libraries raise for wrong values into usage errors.

    :param argument: what the message begins with, such as ``--policy``
    """
    try:
        yield
    except (ValueError, TypeError, OSError) as error:
        message = " ".join(str(error).split())
        raise UsageError(f"{argument}: {message}" if argument else message) from error


def unknown(what: str, value: str, valid: Iterable[str]) -> str:
    """The message for an unknown name.

    :param what: the kind of thing
    :param value: what was given
    :param valid: the names that there are
    :return: the message, with the nearest name and all of them
    """
    names = list(valid)
    close = difflib.get_close_matches(value, names, n=1)
    hint = f" (did you mean {close[0]}?)" if close else ""
    return f"{what} {value!r} is unknown{hint}; there are: {', '.join(names) or 'none'}"
