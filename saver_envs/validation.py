"""The error of an argument or option that is out of range or of another type."""

from __future__ import annotations

import importlib
import math
from collections.abc import Mapping
from dataclasses import fields
from numbers import Integral, Real
from types import ModuleType, NoneType
from typing import Annotated, Any, TypeAlias, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Numbers in a range, in words and as a condition, which `check_fields` checks.
PositiveInt: TypeAlias = Annotated[int, "positive", lambda value: value > 0]
NonNegativeInt: TypeAlias = Annotated[int, "0 or more", lambda value: value >= 0]
PositiveFloat: TypeAlias = Annotated[float, "positive", lambda value: value > 0]
NonNegativeFloat: TypeAlias = Annotated[float, "0 or more", lambda value: value >= 0]
UnitFloat: TypeAlias = Annotated[float, "in [0, 1]", lambda value: 0 <= value <= 1]
FloatBelowOne: TypeAlias = Annotated[float, "in [0, 1)", lambda value: 0 <= value < 1]

#: Type of a field -> the types of its values, in Python and in words.
_TYPES: Mapping[Any, tuple[Any, str]] = {
    str: (str, "a text"),
    int: (int, "a whole number"),
    bool: (bool, "true or false"),
    float: (float | int, "a number"),
    dict[str, Any]: (dict, "a mapping"),
    Mapping[str, Any]: (Mapping, "a mapping"),
    tuple[int, ...]: (tuple, "a list of whole numbers"),
    str | tuple[str, ...]: (str | tuple, "a text or a list of texts"),
}

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


def check_fields(config: Any, prefix: str = "") -> None:
    """Check each value of a dataclass against the type and the range that its field declares.

    :param config: the dataclass; a field may hold another one, or a tuple of them.
    :param prefix: of the fields' names in messages.
    :raises TypeError: for a value of the wrong type.
    :raises ValueError: for a number out of range, or one that is not finite.
    """
    hints = get_type_hints(type(config), include_extras=True)
    for name in (one.name for one in fields(config)):
        hint, value = hints[name], getattr(config, name)
        given = f"{prefix}{name}={value!r} must be"
        optional = NoneType in get_args(hint)
        if optional and value is None:
            continue
        hint = get_args(hint)[0] if optional else hint
        limits = getattr(hint, "__metadata__", ())
        types, words = _types(get_args(hint)[0] if limits else hint)
        if not isinstance(value, types) or (isinstance(value, bool) and types is not bool):
            words += " or null" if optional else ""
            if isinstance(value, str) and types == float | int:
                words += "; YAML reads 1e-3 as text, write 1.0e-3"
            raise TypeError(f"{given} {words}")
        if isinstance(value, float) and not math.isfinite(value):
            raise ValueError(f"{given} finite")
        if limits:
            wanted, within = limits
            if not within(value):
                raise ValueError(f"{given} {wanted}")


def _types(hint: Any) -> tuple[Any, str]:
    if hint in _TYPES:
        return _TYPES[hint]
    # Files hold a dataclass as a mapping.
    several = get_origin(hint) is tuple
    return (tuple, "a list of mappings") if several else (hint, "a mapping of settings")


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
