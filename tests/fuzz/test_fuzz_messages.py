"""Messages of the loop in processes: decoded whole, or a `WireError`."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from fuzzing import ODD, cases, damaged, refusal
from hypothesis import given
from hypothesis import strategies as st

from saver_advisors.integration.bench import EpisodesBench
from saver_advisors.integration.messages import JointTargets, Message, SpacePose, Stamp
from saver_advisors.integration.wire import SignOfLife, Wire, WireError
from saver_envs.registration import make_episodes

WIRE = Wire(EpisodesBench(make_episodes("DualMicoPush-v0")).geometry)
STAMP = Stamp(1.25, 7, "camera")
POSE = WIRE.encode("bench_pose", SpacePose(STAMP, np.zeros((14, 3)), np.ones(14)), 2.0)
TOPIC, BODY = POSE.split(b"\0", 1)
LENGTH = int.from_bytes(BODY[:4])
HEADER, ARRAYS = json.loads(BODY[4 : 4 + LENGTH]), BODY[4 + LENGTH :]


def decoded(message: bytes) -> None:
    found, _ = refusal("messages", lambda: WIRE.decode(message), WireError)
    if found is None:
        return
    topic, content, now = found
    assert isinstance(content, Message)
    assert np.isfinite(now)
    assert np.isfinite(content.stamp.time)
    assert isinstance(topic, str)
    for value in vars(content).values():
        if isinstance(value, np.ndarray) and isinstance(content, JointTargets):
            assert np.isfinite(value).all()


@cases(3.0)
@given(damaged(POSE))
def test_damaged_messages(message: bytes) -> None:
    decoded(message)


def as_json(value: Any) -> bool:
    try:
        json.dumps(value)
    except (TypeError, ValueError):
        return False
    return True


@cases(3.0)
@given(st.data())
def test_headers(data: st.DataObject) -> None:
    """Well-formed messages whose header says something else."""
    keys = [*HEADER, "more"]
    changes = data.draw(st.dictionaries(st.sampled_from(keys), ODD.filter(as_json), min_size=1))
    removed = data.draw(st.sets(st.sampled_from(list(HEADER)), max_size=1))
    header = {key: value for key, value in {**HEADER, **changes}.items() if key not in removed}
    text = json.dumps(header).encode()
    topic = data.draw(st.sampled_from([TOPIC, b"joint_targets", b"servo", b"frame", b"nothing"]))
    decoded(topic + b"\0" + len(text).to_bytes(4) + text + ARRAYS)


@cases()
@given(st.one_of(ODD.filter(as_json).map(lambda v: json.dumps(v).encode()), st.binary(max_size=80)))
def test_signs_of_life(part: bytes) -> None:
    found, _ = refusal("messages", lambda: SignOfLife.read(part), WireError)
    assert found is None or isinstance(found, SignOfLife)


def test_the_message_itself_is_decoded() -> None:
    assert WIRE.decode(POSE)[0] == "bench_pose"
    with pytest.raises(WireError):
        WIRE.decode(POSE[:-1])
