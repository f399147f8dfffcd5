"""The error of an argument or option that is out of range or of another type."""

from __future__ import annotations

import importlib
import math
from numbers import Integral, Real
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: Annotation of an option -> the type of its values, in Python and in words.
_KINDS: dict[str, tuple[Any, str]] = {
    "bool": ((bool, np.bool_), "True or False"),
    "int": (Integral, "a whole number"),
    "float": (Real, "a finite number"),
}


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


def require_share(name: str, value: float) -> None:
    """Check that an argument is a share or a probability.

    :param name: of the argument.
    :param value: that it has.
    :raises ValueError: where it is not within 0 to 1.
    """
    require(name, value, 0 <= value <= 1, "0 to 1")


def require_kind(name: str, value: Any, annotation: object) -> None:
    """Check that an argument is what its annotation says, and finite if it is a number.

    :param name: of the argument.
    :param value: that it has.
    :param annotation: ``bool``, ``int`` or ``float``, also with ``| None``, as a type or as text;
        others are not checked.
    :raises ValueError: for a value of another type. A number is no truth value, nor the reverse.
    """
    kind, _, optional = str(getattr(annotation, "__name__", annotation)).partition(" | ")
    if kind not in _KINDS or (optional and value is None):
        return
    types, valid = _KINDS[kind]
    holds = isinstance(value, types) and (kind == "bool") == isinstance(value, bool | np.bool_)
    require(name, value, holds and (kind != "float" or abs(value) < math.inf), valid)


def import_named(subject: str, module: str) -> ModuleType:
    """Import a module that an argument names.

    :param subject: the argument with its value, for the message.
    :param module: its name.
    :raises ValueError: if it cannot be imported; the message says how the current folder is found.
    """
    try:
        return importlib.import_module(module)
    except (ImportError, ValueError) as error:
        raise ValueError(
            f"{subject} cannot be imported: {error} (is its folder in PYTHONPATH?)"
        ) from error


def real_array(name: str, values: ArrayLike) -> NDArray[Any]:
    """Return an argument as an array of real numbers.

    :param name: what the message calls it.
    :param values: an array, or what NumPy makes one of.
    :raises ValueError: for complex numbers, text and other objects.
    """
    array = np.asarray(values)
    require(name, values, array.dtype.kind in "fiub", "an array of real numbers")
    return array
