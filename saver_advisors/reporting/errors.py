"""Usage errors: one line with the argument, its value, and the valid values."""

from __future__ import annotations

import argparse
import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager


class UsageError(Exception):
    """An error that the user can correct; shown as one line, without a traceback."""


@contextmanager
def user_mistakes(argument: str = "") -> Iterator[None]:
    """Convert the errors that libraries raise for invalid values into usage errors.

    :param argument: start of the message, such as ``argument --policy``
    """
    try:
        yield
    except (ValueError, TypeError, OSError, argparse.ArgumentTypeError) as error:
        message = " ".join(str(error).split())
        raise UsageError(f"{argument}: {message}" if argument else message) from error


def unknown(what: str, value: str, valid: Iterable[str]) -> str:
    """Compose the message for an unknown name.

    :param what: kind of the name
    :param value: the unknown name
    :param valid: the known names
    :return: the message, with the closest name and all of them
    """
    names = list(valid)
    close = difflib.get_close_matches(value, names, n=1)
    hint = f" (did you mean {close[0]}?)" if close else ""
    return f"{what} {value!r} is unknown{hint}; there are: {', '.join(names) or 'none'}"
