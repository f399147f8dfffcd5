"""Messages as bytes: back and forth, and what is no message."""

from __future__ import annotations

import json
import pickle
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from saver_advisors.integration.messages import Picture, ServoCommand, SpacePose, Stamp
from saver_advisors.integration.wire import KINDS, WireError, decode, encode

STAMP = Stamp(1.25, 7, "camera")


def sent(**changes: object) -> list[bytes]:
    """A good message, with entries of its header changed."""
    pose = SpacePose(STAMP, np.ones((14, 3)), np.ones(14))
    parts = encode("poses", pose, 2.0)
    return [parts[0], json.dumps({**json.loads(parts[1]), **changes}).encode(), *parts[2:]]


@settings(max_examples=50, deadline=None)
@given(
    arrays(np.uint8, array_shapes(min_dims=3, max_dims=3, max_side=6)),
    st.floats(allow_nan=False, allow_infinity=False),
    st.integers(0, 2**40),
    st.text(max_size=20),
)
def test_what_is_sent_arrives(rgb: np.ndarray, time: float, number: int, source: str) -> None:
    picture = Picture(Stamp(time, number, source), rgb, np.full(rgb.shape[:2], np.nan, np.float32))
    topic, found, now = decode(encode("frame", picture, 3.5))
    assert (topic, now, found.stamp) == ("frame", 3.5, picture.stamp)
    assert isinstance(found, Picture)
    np.testing.assert_array_equal(found.rgb, rgb)
    np.testing.assert_array_equal(found.depth, picture.depth)
    assert found.depth.dtype == np.float32
    found.rgb[:] = 0  # an array of its own


def test_plain_fields_arrive() -> None:
    command = ServoCommand(STAMP, np.zeros((2, 4)), True, "pose: no person found")
    _, found, _ = decode(encode("servo", command, 0.0))
    assert isinstance(found, ServoCommand)
    assert (found.holding, found.cause) == (True, "pose: no person found")


def test_every_kind_of_message_can_be_sent() -> None:
    for kind in KINDS.values():
        types = {field.name: str(field.type) for field in fields(kind)}
        values = {
            name: STAMP if name == "stamp" else np.zeros((2, 3), dtype=bool)
            for name, type_name in types.items()
            if type_name not in ("bool", "str", "float")
        }
        values |= {n: t == "x" if t == "bool" else 1.0 if t == "float" else "" for n, t in
                   types.items() if t in ("bool", "str", "float")}  # fmt: skip
        _, found, _ = decode(encode("topic", kind(**values), 0.0))
        assert type(found) is kind


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ([b"poses"], "1 parts"),
        ([b"poses", b"\x80\x04N."], "no JSON"),
        ([b"poses", pickle.dumps({"kind": "SpacePose"})], "no JSON"),
        ([b"poses", b"[]"], "no object"),
        (sent(kind="Popen"), "kind 'Popen': must be one of"),
        (sent(arrays=[]), "2 arrays came"),
        (sent(stamp=[0, 0]), "stamp="),
        (sent(now="soon"), "now='soon'"),
        (sent(plain={"shell": "true"}), "must have"),
        (sent(plain=None), "plain=None"),
        ([*sent()[:2], b"short", sent()[3]], "has 5 bytes, not 336"),
        ([b"\xff", *sent()[1:]], "no text"),
    ],
)
def test_what_is_no_message_is_refused(parts: list[bytes], words: str) -> None:
    with pytest.raises(WireError, match=words):
        decode(parts)


@pytest.mark.parametrize(
    "description",
    [
        {"name": "positions", "type": "object", "shape": [42]},
        {"name": "positions", "type": "float64", "shape": [-14, 3]},
        {"name": "positions", "type": "float64", "shape": [2**20, 2**20]},
        {"name": "positions", "type": "float64", "shape": [1] * 40},
        {"name": "positions", "shape": [14, 3]},
        "positions",
    ],
)
def test_arrays_that_cannot_be_are_refused(description: object) -> None:
    other = {"name": "scores", "type": "float64", "shape": [14]}
    with pytest.raises(WireError, match="array"):
        decode(sent(arrays=[description, other]))


@settings(max_examples=200, deadline=None)
@given(st.lists(st.binary(max_size=60), max_size=4))
def test_random_bytes_are_refused_and_nothing_else(parts: list[bytes]) -> None:
    with pytest.raises(WireError):
        decode(parts)


def test_what_has_no_place_in_a_message_is_refused() -> None:
    with pytest.raises(TypeError, match=r"SpacePose\.scores of list cannot be sent"):
        encode("poses", SpacePose(STAMP, np.ones((14, 3)), [1.0]), 0.0)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="message of class str"):
        encode("poses", "hello", 0.0)  # type: ignore[arg-type]
