"""Messages between processes: a JSON header and the arrays' bytes; nothing is unpickled.

A message contains its topic and a zero byte, the header's length and the header, and the arrays.
The header contains stamp and the sender's time. Class, types and shapes follow from the topic and
the bench, so that a message of another size is refused before anything is allocated for it. It is
a single ZeroMQ part: the rest of one in several parts might never arrive.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any, Final, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

from saver_advisors.integration import messages as kinds
from saver_advisors.integration.bench import BenchGeometry
from saver_advisors.integration.messages import Message, Stamp

#: Topic -> class of its messages.
KINDS: Final[Mapping[str, type[Message]]] = {
    **dict.fromkeys(("frame", "picture"), kinds.Picture),
    **dict.fromkeys(("camera_pose", "bench_pose"), kinds.SpacePose),
    "pixel_pose": kinds.PixelPose,
    "person": kinds.Person,
    "arms": kinds.ArmReading,
    "action": kinds.Action,
    "set_points": kinds.SetPoints,
    "joint_targets": kinds.JointTargets,
}
#: Longest header or sign of life (bytes).
LONGEST_TEXT: Final = 2**16


class WireError(ValueError):
    """Report bytes that are not a message; states what is wrong with them."""


@dataclass(frozen=True)
class _ArrayKind:
    """What an array must be.

    :param name: of class and field.
    :param nan: whether NaN is allowed.
    """

    name: str
    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    nan: bool

    @property
    def size(self) -> int:
        """Its bytes."""
        return math.prod(self.shape) * self.dtype.itemsize

    def checked(self, array: Any) -> NDArray[Any]:
        """Return the array in its type and in one piece.

        :raises WireError: for another type or shape, or a value that is not finite.
        """
        values = np.asarray(array)
        if values.shape != self.shape or not np.can_cast(values.dtype, self.dtype, "same_kind"):
            must = f"must be {self.dtype}{list(self.shape)}"
            raise WireError(f"{self.name} of {values.dtype}{list(values.shape)}: {must}")
        if (
            values.dtype.kind == "f"
            and not (np.isfinite(values) | (self.nan and np.isnan(values))).all()
        ):
            raise WireError(f"{self.name}: every value must be finite{' or NaN' * self.nan}")
        return values.astype(self.dtype, order="C", copy=False)


class Wire:
    """Turn the messages of a bench into bytes and back.

    :param geometry: of the bench: gives the number of arms and joints and the camera's size.
    """

    def __init__(self, geometry: BenchGeometry) -> None:
        camera = geometry.camera
        sizes = {"height": camera.height, "width": camera.width}
        sizes |= {"arms": len(geometry.base_position), "dof": len(geometry.robot.arm_joints)}
        self._arrays = {
            topic: {
                name: _array_kind(f"{kind.__name__}.{name}", hint, sizes)
                for name, hint in get_type_hints(kind, include_extras=True).items()
                if name != "stamp"
            }
            for topic, kind in KINDS.items()
        }

    def longest(self, topics: Collection[str]) -> int:
        """Return the bytes of the longest message of these topics, or of a sign of life."""
        sizes = [sum(kind.size for kind in self._arrays[topic].values()) for topic in topics]
        return 2 * LONGEST_TEXT + max(sizes, default=0)

    def encode(self, topic: str, message: Message, now: float) -> bytes:
        """Encode a message.

        :param topic: of the message, one of `KINDS`.
        :param message: of its class.
        :param now: the sender's time, seconds of the trial.
        :return: its bytes.
        :raises WireError: for another topic or class, or a value that must not be sent.
        """
        if type(message) is not KINDS.get(topic):
            raise WireError(f"topic {topic!r} with a message of {type(message).__name__}")
        stamp = [message.stamp.time, message.stamp.sequence, message.stamp.source]
        _stamp(stamp)
        header = json.dumps({"now": now, "stamp": stamp}).encode()
        arrays = self._arrays[topic].items()
        parts = [kind.checked(getattr(message, name)).tobytes() for name, kind in arrays]
        return b"".join([topic.encode() + b"\0", len(header).to_bytes(4), header, *parts])

    def decode(self, message: bytes) -> tuple[str, Message, float]:
        """Decode a message.

        :param message: as received.
        :return: topic, message and the sender's time.
        :raises WireError: for anything that :meth:`encode` does not return.
        """
        end = message.find(b"\0", 0, 40) + 1
        topic = message[: max(end - 1, 0)].decode(errors="replace")
        if topic not in KINDS:
            raise WireError(f"topic {topic!r}: must be one of {', '.join(KINDS)}")
        arrays = self._arrays[topic]
        begin, length = end + 4, int.from_bytes(message[end : end + 4])
        header, offset = read_json(message[begin : begin + length]), begin + length
        size = offset + sum(kind.size for kind in arrays.values())
        if len(message) != size:
            raise WireError(f"{topic!r} of {len(message)} bytes: must be {size}")
        values = {}
        for name, kind in arrays.items():
            count = math.prod(kind.shape)
            array = np.frombuffer(message, kind.dtype, count, offset).reshape(kind.shape)
            # The copy is writable and does not keep the message alive.
            values[name] = kind.checked(array.copy())[()]
            offset += kind.size
        now: Any = header.get("now")
        if not _is_number(now):
            raise WireError(f"now={now!r}: must be a time")
        stamp = _stamp(header.get("stamp"))
        return topic, KINDS[topic](stamp=stamp, **values), float(now)


def read_json(part: bytes) -> dict[str, Any]:
    """Parse a JSON object of at most `LONGEST_TEXT` bytes.

    :raises WireError: for anything else.
    """
    if len(part) > LONGEST_TEXT:
        raise WireError(f"the header has {len(part)} bytes: must be {LONGEST_TEXT} at most")
    try:
        value = json.loads(part)
    except (ValueError, RecursionError) as error:
        raise WireError(f"the header is no JSON: {error}") from error
    if not isinstance(value, dict):
        raise WireError("the header is no object")
    return value


@dataclass(frozen=True)
class SignOfLife:
    """What a process reports about itself.

    :param stages: stage -> number of calls and mean wall-clock seconds.
    :param faults: stage -> reason.
    :param events: kind, stage and reason of each.
    """

    stages: dict[str, list[float]]
    faults: dict[str, str]
    events: list[list[str]]

    @staticmethod
    def read(part: bytes) -> SignOfLife:
        """Read what was written as JSON.

        :raises WireError: for anything else.
        """
        sign = read_json(part)
        match sign:
            case {"stages": dict(stages), "faults": dict(faults), "events": list(events)}:
                if (
                    all(_is_list(row, 2, _is_number) for row in stages.values())
                    and all(_is_list(row, 3, _is_text) for row in events)
                    and all(map(_is_text, faults.values()))
                ):
                    return SignOfLife(stages, faults, events)
        raise WireError(f"sign of life {str(sign)[:80]}: must have stages, faults and events")


def _is_number(value: Any) -> bool:
    # Python's comparison, since a JSON integer can be too large for a float.
    return isinstance(value, int | float) and type(value) is not bool and abs(value) < 2**53


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_list(value: Any, length: int, is_valid: Callable[[Any], bool]) -> bool:
    return isinstance(value, list) and len(value) == length and all(map(is_valid, value))


def _stamp(value: Any) -> Stamp:
    match value:
        case [time, int(sequence), str(source)] if _is_number(time) and time >= 0:
            return Stamp(float(time), sequence, source)
    raise WireError(f"stamp={value!r}: must be time, sequence and source")


def _array_kind(name: str, hint: Any, sizes: Mapping[str, int]) -> _ArrayKind:
    array, shape, *nan = get_args(hint)
    scalar = float if array is float else get_args(get_args(array)[1])[0]
    numbers = tuple(sizes[size] if size in sizes else int(size) for size in shape.split())
    return _ArrayKind(name, np.dtype(scalar), numbers, bool(nan))
