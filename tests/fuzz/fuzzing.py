"""Input that nobody should pass, and what is allowed to happen then.

`make fuzz` tries thousands of cases, `make test` the first few of them. FUZZ_CASES says how many a
test gets.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

CASES = int(os.environ.get("FUZZ_CASES", "15"))
#: Cases so far by subject.
TRIED: Counter[str] = Counter()

#: What people and files pass by mistake, with numbers near the ends of usual ranges.
ODD = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.integers(-2, 6),
    st.floats(),
    st.floats(0.0, 2.0),
    st.complex_numbers(),
    st.text(max_size=5),
    st.binary(max_size=3),
    st.lists(st.floats(), max_size=3),
    st.dictionaries(st.text(max_size=3), st.integers(), max_size=2),
    st.builds(object),
)

#: Arrays of any shape with numbers, texts or truth values.
ODD_ARRAYS = st.sampled_from(
    [np.float64, np.float32, np.float16, np.int64, np.uint8, np.bool_, np.complex64, "U3", "S2"]
).flatmap(lambda dtype: arrays(dtype, array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=5)))


def cases(weight: float = 1.0) -> settings:
    """Settings of a test that gets `weight` times the usual number of cases."""
    return settings(
        max_examples=max(5, round(weight * CASES)),
        deadline=None,
        suppress_health_check=list(HealthCheck),
        derandomize="FUZZ_CASES" not in os.environ,
        database=None,
    )


def refusal(subject: str, call: Callable[[], Any], *kinds: type[Exception]) -> tuple[Any, str]:
    """Return what a call returned, or the message with which it refused its input.

    Any exception but the given ones fails the test, and so does one that says nothing.
    """
    TRIED[subject] += 1
    try:
        return call(), ""
    except kinds as error:
        message = str(error)
        assert len(message) > 10, f"{type(error).__name__} does not say what is wrong: {message!r}"
        return None, message


def damaged(whole: bytes) -> st.SearchStrategy[bytes]:
    """Versions of a file: cut, with bytes changed, inserted or repeated, and other files."""

    def changed(edits: list[tuple[float, int, bytes]]) -> bytes:
        data = bytearray(whole)
        for place, length, replacement in edits:
            start = int(place * len(data))
            data[start : start + length] = replacement
        return bytes(data)

    edit = st.tuples(st.floats(0.0, 1.0), st.integers(0, 12), st.binary(max_size=12))
    head = st.tuples(st.floats(0.0, 200 / len(whole)), st.integers(0, 4), st.binary(max_size=4))
    return st.one_of(
        st.integers(0, len(whole) - 1).map(lambda length: whole[:length]),
        st.lists(edit, min_size=1, max_size=4).map(changed),
        st.lists(head.filter(lambda one: one[0] < 1.0), min_size=1, max_size=3).map(changed),
        st.binary(max_size=200),
    )
