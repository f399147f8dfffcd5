"""The error of an argument or option that is out of range."""

from __future__ import annotations


def require(name: str, value: object, holds: bool, valid: str) -> None:
    """Check an argument.

    :param name: of the argument.
    :param value: that it has.
    :param holds: whether the value is valid.
    :param valid: what values are valid, such as ``above 0 m``.
    :raises ValueError: where the value is not valid; the message has all three texts.
    """
    if not holds:
        raise ValueError(f"{name}={value!r}: must be {valid}")
