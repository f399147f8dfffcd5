"""Messages as bytes: back and forth, and what is no message."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from typing import get_type_hints

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from saver_advisors.integration.bench import EpisodesBench
from saver_advisors.integration.messages import (
    ArmReading,
    JointTargets,
    Message,
    Picture,
    PixelPose,
    ServoCommand,
    SpacePose,
    Stamp,
)
from saver_advisors.integration.wire import KINDS, SignOfLife, Wire, WireError
from saver_envs.registration import make_episodes

STAMP = Stamp(1.25, 7, "camera")
BENCH = EpisodesBench(make_episodes("DualMicoPush-v0"))
GEOMETRY = BENCH.geometry
WIRE = Wire(GEOMETRY)
HEIGHT, WIDTH = GEOMETRY.camera.height, GEOMETRY.camera.width
POSE = SpacePose(STAMP, np.full((14, 3), np.nan), np.ones(14))


def sent(**changes: object) -> bytes:
    """A good message, with entries of its header changed."""
    topic, rest = WIRE.encode("bench_pose", POSE, 2.0).split(b"\0", 1)
    length = int.from_bytes(rest[:4])
    header = json.dumps({**json.loads(rest[4 : 4 + length]), **changes}).encode()
    return topic + b"\0" + len(header).to_bytes(4) + header + rest[4 + length :]


@settings(max_examples=50, deadline=None)
@given(
    arrays(np.float64, (14, 2), elements=st.floats(allow_infinity=False)),
    st.floats(0, 1e6),
    st.integers(0, 2**40),
    st.text(max_size=20),
)
def test_what_is_sent_arrives(joints: np.ndarray, time: float, number: int, source: str) -> None:
    pose = PixelPose(Stamp(time, number, source), joints, np.zeros(14))
    topic, found, now = WIRE.decode(WIRE.encode("pixel_pose", pose, 3.5))
    assert (topic, now, found.stamp) == ("pixel_pose", 3.5, pose.stamp)
    assert isinstance(found, PixelPose)
    np.testing.assert_array_equal(found.joints, joints)
    found.joints[:] = 0  # an array of its own


def test_pictures_arrive() -> None:
    rgb = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
    picture = Picture(STAMP, rgb, np.ones((HEIGHT, WIDTH), np.float32))
    _, found, _ = WIRE.decode(WIRE.encode("frame", picture, 0.0))
    assert isinstance(found, Picture)
    np.testing.assert_array_equal(found.rgb, rgb)
    assert found.depth.dtype == np.float32


def test_numbers_arrive() -> None:
    reading = replace(BENCH.reading(STAMP), torso_force=3.25)
    _, found, _ = WIRE.decode(WIRE.encode("arms", reading, 0.0))
    assert isinstance(found, ArmReading)
    assert isinstance(found.torso_force, float)
    assert found.torso_force == 3.25
    np.testing.assert_array_equal(found.jacobian, reading.jacobian)


def test_every_kind_of_message_but_the_bench_s_own_has_a_topic() -> None:
    assert {*KINDS.values(), ServoCommand} == set(Message.__subclasses__())
    for kind in KINDS.values():
        assert get_type_hints(kind)["stamp"] is Stamp


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "topic ''"),
        (b"bench_pose", "topic ''"),
        (b"bench_pose\0", "no JSON"),
        (b"bench_pose\0" + len(pickle.dumps({})).to_bytes(4) + pickle.dumps({}), "no JSON"),
        (b"bench_pose\0\0\0\0\2[]", "no object"),
        (b"bench_pose\0\xff\xff\xff\xff{}", "must be"),
        (b"Popen" + sent(), "topic 'Popenbench_pose'"),
        (b"\xff" + sent(), "topic"),
        (sent()[:-1], "must be"),
        (sent() + b"x", "must be"),
        (sent(stamp=[0, 0]), "stamp="),
        (sent(stamp=["0", 0, ""]), "stamp="),
        (sent(stamp=[float("inf"), 0, ""]), "stamp="),
        (sent(now="soon"), "now='soon'"),
        (sent(now=True), "now=True"),
    ],
)
def test_what_is_no_message_is_refused(content: bytes, words: str) -> None:
    with pytest.raises(WireError, match=words):
        WIRE.decode(content)


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=200), st.sampled_from(["", *(f"{one}\0" for one in KINDS)]))
def test_random_bytes_are_refused_and_nothing_else(content: bytes, topic: str) -> None:
    with pytest.raises(WireError):
        WIRE.decode(topic.encode() + content)
    with pytest.raises(WireError):
        SignOfLife.read(content)


@pytest.mark.parametrize(
    ("topic", "message", "words"),
    [
        (
            "bench_pose",
            SpacePose(STAMP, np.ones((13, 3)), np.ones(14)),
            r"must be float64\[14, 3\]",
        ),
        ("bench_pose", SpacePose(STAMP, np.full((14, 3), np.inf), np.ones(14)), "finite or NaN"),
        ("bench_pose", SpacePose(STAMP, np.ones((14, 3)), np.full(14, np.nan)), "must be finite"),
        ("bench_pose", SpacePose(STAMP, np.ones((14, 3)), np.array(["a"] * 14)), "must be float64"),
        ("action", JointTargets(STAMP, np.zeros((2, 4))), "a message of JointTargets"),
        ("topic", JointTargets(STAMP, np.zeros((2, 4))), "topic 'topic'"),
        ("joint_targets", "hello", "a message of str"),
    ],
)
def test_what_has_no_place_in_a_message_is_not_sent(
    topic: str, message: Message, words: str
) -> None:
    with pytest.raises(WireError, match=words):
        WIRE.encode(topic, message, 0.0)
