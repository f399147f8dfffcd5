"""Messages between processes: a JSON header and the arrays' bytes; nothing is unpickled.

A message has several parts: topic, header, then one part per array. The header contains the class,
the stamp, plain fields, and name, type and shape of each array.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import fields
from typing import Any, Final

import numpy as np

from saver_advisors.integration.messages import Message, Stamp

#: Class name -> class, of all messages.
KINDS: Final[dict[str, type[Message]]] = {kind.__name__: kind for kind in Message.__subclasses__()}
#: Types that arrays may have.
TYPES: Final = ("float64", "float32", "uint8", "bool", "int64")
#: Largest array (bytes); a Full HD colour picture has 6 MB.
LARGEST: Final = 32 * 2**20
_PLAIN: Final = (bool, int, float, str)


class WireError(ValueError):
    """Report bytes that are not a message; states what is wrong with them."""


def encode(topic: str, message: Message, now: float) -> list[bytes]:
    """Encode a message.

    :param topic: of the message.
    :param message: of one of the classes in `KINDS`.
    :param now: the sender's time, seconds of the trial.
    :return: its parts.
    :raises TypeError: for a message of another class, or a field that is neither plain nor an
        array.
    """
    kind = type(message).__name__
    if KINDS.get(kind) is not type(message):
        raise TypeError(f"message of class {kind}: must be one of {', '.join(KINDS)}")
    plain: dict[str, Any] = {}
    arrays: list[dict[str, Any]] = []
    parts: list[bytes] = []
    for field in fields(message):
        value = getattr(message, field.name)
        if field.name == "stamp":
            continue
        if isinstance(value, np.ndarray) and value.dtype.name in TYPES:
            arrays.append({"name": field.name, "type": value.dtype.name, "shape": value.shape})
            parts.append(np.ascontiguousarray(value).tobytes())
        elif isinstance(value, _PLAIN):
            plain[field.name] = value
        else:
            raise TypeError(f"{kind}.{field.name} of {type(value).__name__} cannot be sent")
    stamp = [message.stamp.time, message.stamp.sequence, message.stamp.source]
    header = {"kind": kind, "now": now, "stamp": stamp, "plain": plain, "arrays": arrays}
    return [topic.encode(), json.dumps(header).encode(), *parts]


def decode(parts: Sequence[bytes]) -> tuple[str, Message, float]:
    """Decode a message.

    :param parts: as received.
    :return: topic, message and the sender's time.
    :raises WireError: for anything that :func:`encode` does not return.
    """
    if len(parts) < 2:
        raise WireError(f"{len(parts)} parts: must be topic, header and arrays")
    header = read_json(parts[1])
    kind = KINDS.get(str(header.get("kind")))
    if kind is None:
        raise WireError(f"kind {header.get('kind')!r}: must be one of {', '.join(KINDS)}")
    values = _plain_fields(header)
    described = header.get("arrays")
    if not isinstance(described, list) or len(described) != len(parts) - 2:
        raise WireError(f"{kind.__name__}: {len(parts) - 2} arrays came, the header differs")
    values |= dict(map(_array, described, parts[2:]))
    expected = {field.name for field in fields(kind)} - {"stamp"}
    if set(values) != expected:
        raise WireError(
            f"{kind.__name__} has fields {sorted(values)}, must have {sorted(expected)}"
        )
    now = header.get("now")
    if not isinstance(now, int | float) or not math.isfinite(now):
        raise WireError(f"now={now!r}: must be a time")
    message = kind(stamp=_stamp(header.get("stamp")), **values)
    try:
        return parts[0].decode(), message, float(now)
    except UnicodeDecodeError as error:
        raise WireError(f"the topic is no text: {error}") from error


def read_json(part: bytes) -> dict[str, Any]:
    """Parse a JSON object.

    :raises WireError: for anything else.
    """
    try:
        value = json.loads(part)
    except (ValueError, RecursionError) as error:
        raise WireError(f"the header is no JSON: {error}") from error
    if not isinstance(value, dict):
        raise WireError("the header is no object")
    return value


def _plain_fields(header: dict[str, Any]) -> dict[str, Any]:
    plain = header.get("plain")
    if not isinstance(plain, dict) or not all(isinstance(one, _PLAIN) for one in plain.values()):
        raise WireError(f"plain={plain!r}: must be plain values by name")
    return dict(plain)


def _stamp(value: Any) -> Stamp:
    match value:
        case [int() | float() as time, int() as sequence, str() as source]:
            return Stamp(float(time), sequence, source)
    raise WireError(f"stamp={value!r}: must be time, sequence and source")


def _array(description: Any, part: bytes) -> tuple[str, np.ndarray]:
    match description:
        case {"name": str() as name, "type": str() as kind, "shape": list() as shape}:
            pass
        case _:
            raise WireError(f"array {description!r}: must have a name, a type and a shape")
    if kind not in TYPES:
        raise WireError(f"array {name!r} of type {kind!r}: must be one of {', '.join(TYPES)}")
    if len(shape) > 4 or not all(type(size) is int and 0 <= size <= LARGEST for size in shape):
        raise WireError(f"array {name!r} of shape {shape!r}: must be up to 4 sizes")
    size = math.prod(shape) * np.dtype(kind).itemsize
    if size > LARGEST or size != len(part):
        raise WireError(f"array {name!r} of {kind}{shape} has {len(part)} bytes, not {size}")
    # The copy is writable and does not keep the message alive.
    return name, np.frombuffer(part, dtype=kind).reshape(shape).copy()
