"""Rates, latencies, order, faults and crashes of stages on a clock without physics."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_loops import Clock, Relay, Source

from saver_advisors.integration.assembly import LoopSettings
from saver_advisors.integration.control_stages import ENCODER_RATE, POLICY_RATE
from saver_advisors.integration.graph import RESTART_AFTER, Graph
from saver_advisors.integration.health import Health
from saver_advisors.integration.messages import Message
from saver_advisors.integration.stage import MEASURED, StageFault


def graph(*stages: Source | Relay, silence: dict[str, float] | None = None) -> Graph:
    return Graph(stages, Health([one.name for one in stages], silence or {}))


def test_a_source_works_at_its_rate() -> None:
    source = Source("camera", "frame", rate=30.0)
    loop = graph(source)
    loop.run_until(1.0, Clock().advance_to)
    assert source.count == 30


def test_results_are_seen_after_the_latency() -> None:
    relay = Relay("pose", "poses", ("frame",))
    loop = graph(Source("camera", "frame", rate=10.0, latency=0.025), relay)
    loop.run_until(0.3, Clock().advance_to)
    assert [round(time, 6) for time, _ in relay.got] == [0.025, 0.125, 0.225]


def test_a_chain_without_latency_is_passed_through_at_once() -> None:
    last = Relay("c", "z", ("y",))
    loop = graph(Source("a", "x", rate=10.0), Relay("b", "y", ("x",)), last)
    loop.run_until(0.15, Clock().advance_to)
    assert [time for time, _ in last.got] == pytest.approx([0.0, 0.1])


def test_a_slow_stage_takes_the_newest_of_what_waits() -> None:
    slow = Relay("pose", "poses", ("frame",), latency=0.35)
    loop = graph(Source("camera", "frame", rate=10.0), slow)
    loop.run_until(1.0, Clock().advance_to)
    assert slow.got == [(0.0, 1), (pytest.approx(0.35), 4), (pytest.approx(0.7), 8)]


def test_a_triggered_stage_keeps_to_its_rate() -> None:
    policy = Relay("policy", "action", ("arms",), 25.0)
    loop = graph(Source("encoders", "arms", rate=100.0), policy)
    loop.run_until(0.2, Clock().advance_to)
    assert [time for time, _ in policy.got] == pytest.approx([0.0, 0.04, 0.08, 0.12, 0.16])


def test_measured_latency_is_that_of_the_call() -> None:
    seen: list[float] = []
    loop = graph(Source("camera", "frame", rate=10.0, latency=MEASURED))
    loop.observers.append(lambda topic, message, now: seen.append(now))
    loop.run_until(0.05, Clock().advance_to)
    assert seen == pytest.approx(loop.seconds["camera"][:1])


def test_a_fault_is_told_until_the_next_success() -> None:
    def fail(message: Message, now: float) -> None:
        if 0.25 < now < 0.55:
            raise StageFault("too dark")

    loop = graph(Source("camera", "frame", rate=10.0), Relay("pose", "poses", ("frame",), act=fail))
    loop.run_until(0.5, Clock().advance_to)
    cause = loop.health.cause(0.5)
    assert cause is not None
    assert (cause.stage, cause.reason) == ("pose", "too dark")
    loop.run_until(0.7, Clock(0.5).advance_to)
    assert loop.health.cause(0.7) is None


def test_a_crashed_stage_is_started_again() -> None:
    def crash(message: Message, now: float) -> None:
        if 0.25 < now < 0.35:
            raise ZeroDivisionError("division by zero")

    relay = Relay("pose", "poses", ("frame",), act=crash)
    loop = graph(Source("camera", "frame", rate=10.0), relay)
    loop.run_until(1.0, Clock().advance_to)
    assert [event.kind for event in loop.health.log] == ["crashed", "restarted"]
    assert "division by zero" in loop.health.log[0].reason
    times = [time for time, _ in relay.got]
    assert not any(0.31 < time < 0.3 + RESTART_AFTER - 1e-6 for time in times)
    assert times[-1] == pytest.approx(0.9)
    assert loop.health.cause(1.0) is None


def test_the_cause_is_the_silent_stage_nearest_to_the_camera() -> None:
    health = Health(["camera", "pose", "policy"], dict.fromkeys(("camera", "pose", "policy"), 0.05))
    for stage, time in (("camera", 0.1), ("pose", 0.12), ("policy", 0.14)):
        health.heard(stage, time)
    assert health.cause(0.149) is None
    cause = health.cause(0.3)
    assert cause is not None
    assert (cause.stage, cause.reason) == ("camera", "nothing for 200 ms")
    health.heard("camera", 0.29)
    cause = health.cause(0.3)
    assert cause is not None and cause.reason == "nothing for 180 ms"


def test_a_second_trial_runs_like_the_first() -> None:
    relay = Relay("pose", "poses", ("frame",), latency=0.013)
    loop = graph(Source("camera", "frame", rate=30.0, latency=0.004), relay)
    loop.run_until(0.5, Clock().advance_to)
    first, relay.got = relay.got, []
    loop.reset()
    loop.run_until(0.5, Clock().advance_to)
    assert relay.got == first


@settings(max_examples=60, deadline=None)
@given(
    rate=st.floats(5, 60),
    first=st.floats(0, 0.1),
    second=st.floats(0, 0.1),
    stops=st.integers(1, 5),
)
def test_nothing_is_seen_too_early_or_out_of_order(
    rate: float, first: float, second: float, stops: int
) -> None:
    relay = Relay("pose", "poses", ("frame",), latency=second)
    loop = graph(Source("camera", "frame", rate=rate, latency=first), relay)
    seen: list[tuple[float, float, int]] = []
    loop.observers.append(
        lambda topic, message, now: (
            seen.append((now, message.stamp.time, message.stamp.sequence))
            if topic == "poses"
            else None
        )
    )
    clock = Clock()
    for stop in np.linspace(0, 1, stops + 1)[1:]:
        loop.run_until(float(stop), clock.advance_to)
    assert all(now >= taken + first + second - 1e-6 for now, taken, _ in seen)
    assert [number for *_, number in seen] == sorted({number for *_, number in seen})
    # As many as the slower of the two lets through, but for the ends.
    if second > 0:
        assert len(seen) <= 1 / max(1 / rate, second) + 2


@pytest.mark.parametrize(
    ("stages", "words"),
    [
        ((Source("a", "x", rate=1.0), Source("a", "y", rate=1.0)), "name 'a' is used twice"),
        ((Source("a", "x", rate=1.0), Source("b", "x", rate=1.0)), "output 'x' is used twice"),
        ((Relay("a", "x", ("nothing",)),), "reads 'nothing', which no stage writes; there are x"),
    ],
)
def test_a_graph_that_cannot_be_is_refused(stages: tuple[Source, ...], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        graph(*stages)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "rate=None: 'a' has no inputs"),
        ({"rate": 0.0}, "rate=0.0 of 'a'"),
        ({"rate": 1.0, "latency": -0.1}, "latency=-0.1 of 'a'"),
        ({"rate": 1.0, "latency": "slow"}, "latency='slow' of 'a'"),
    ],
)
def test_a_stage_that_cannot_be_is_refused(options: dict[str, float], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Source("a", "x", **options)  # type: ignore[arg-type]


def test_allowed_silence_is_in_periods() -> None:
    allowed = LoopSettings(silent_periods=3.0).silence()
    assert allowed["policy"] == pytest.approx(3 / POLICY_RATE)
    assert allowed["encoders"] == pytest.approx(6 / ENCODER_RATE)
