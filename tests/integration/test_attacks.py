"""Attacks on the loop in processes: none moves an arm beyond its limits or ends the bench."""

from __future__ import annotations

import contextlib
import json
import os
import resource
import socket
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zmq
from small_loops import Push, SmallLoop

from saver_advisors.integration.assembly import LoopSettings, build_loop, settings_for
from saver_advisors.integration.bench import EpisodesBench
from saver_advisors.integration.hub import ALIVE, Hub, open_socket
from saver_advisors.integration.messages import (
    ArmReading,
    JointTargets,
    Message,
    ServoCommand,
    Stamp,
)
from saver_advisors.integration.safety import BURST, JOINT_EXCESS, SafetyLimits
from saver_advisors.integration.stage import Inputs, LoopStage
from saver_advisors.integration.supervisor import ProcessLoop
from saver_advisors.integration.wire import KINDS, SignOfLife, Wire
from saver_advisors.integration.wrist_bench import WristBench
from saver_envs.control import least_squares_step
from saver_envs.registration import make_episodes

SETTINGS = LoopSettings(
    seeing=False, learned_kinematics=False, limits=SafetyLimits(max_speed=0.5, clearance=0.0)
)
#: What an attack may cost (bytes).
MOST_MEMORY = 100 * 2**20
TARGETS = {"joint_targets": "kinematics"}


class Attacker:
    """A process that has certain keys, or none."""

    def __init__(self, keys: dict[str, str], bare: bool = False) -> None:
        self.context = zmq.Context()
        if bare:
            self.socket = self.context.socket(zmq.PUSH)
        else:
            self.socket = open_socket(self.context, zmq.PUSH, -1, keys)
        self.socket.connect(keys["results"])

    def send(self, content: bytes) -> None:
        """Send without waiting for anyone to read."""
        with contextlib.suppress(zmq.Again):
            self.socket.send(content, zmq.NOBLOCK)


Attack = Callable[..., Attacker]


@pytest.fixture
def attack() -> Iterator[Attack]:
    """Make attackers, which end with the test."""
    attackers: list[Attacker] = []

    def make(keys: dict[str, str], bare: bool = False) -> Attacker:
        attackers.append(Attacker(keys, bare))
        return attackers[-1]

    yield make
    for one in attackers:
        one.context.destroy(linger=0)


def packed(topic: bytes, header: bytes, array: bytes = bytes(64)) -> bytes:
    """A message from its parts, unchecked."""
    return topic + b"\0" + len(header).to_bytes(4) + header + array


def targets(
    joints: object, time: float = 0.0, source: str = "kinematics", topic: str = "joint_targets"
) -> bytes:
    """Joint targets as bytes, unchecked."""
    header = json.dumps({"now": time, "stamp": [time, 1, source]}).encode()
    return packed(topic.encode(), header, np.asarray(joints, float).tobytes())


def sign(**changes: object) -> bytes:
    """A sign of life with entries changed."""
    good = {"stages": {"kinematics": [1, 0.1]}, "faults": {}, "events": []}
    return ALIVE + json.dumps({**good, **changes}).encode()


@pytest.fixture(scope="module")
def bench() -> EpisodesBench:
    return EpisodesBench(make_episodes("DualMicoPush-v0"))


@pytest.fixture
def hub(bench: EpisodesBench) -> Iterator[Hub]:
    one = Hub(Wire(bench.geometry), KINDS, ["joint_targets"])
    yield one
    one.close()


def heard(hub: Hub, seconds: float = 1.0) -> tuple[list[Message], list[SignOfLife]]:
    """What a hub accepts within a time."""
    messages: list[Message] = []
    signs: list[SignOfLife] = []
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        messages += [message for _, message in hub.received(lambda key, one: signs.append(one))]
        time.sleep(0.01)
    return messages, signs


def still_works(hub: Hub, attack: Attack) -> None:
    """The owner of a topic is heard, whatever else happens."""
    owner = attack(hub.admit(TARGETS))
    messages: list[Message] = []
    end = time.monotonic() + 20
    while not messages and time.monotonic() < end:
        owner.send(targets(np.full((2, 4), 0.5)))
        messages = heard(hub, 0.1)[0]
    assert np.array_equal(messages[0].joints, np.full((2, 4), 0.5))  # type: ignore[attr-defined]


def memory() -> int:
    """The peak of this process's memory, bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def test_1_a_stranger_without_keys_is_not_heard(hub: Hub, attack: Attack) -> None:
    stranger = attack(hub.admit(TARGETS), bare=True)
    stranger.send(targets(np.full((2, 4), 6.0)))
    stranger.send(sign(faults=3))
    assert heard(hub) == ([], [])
    assert not hub.refused
    still_works(hub, attack)


def test_2_a_stranger_with_keys_of_its_own_is_not_heard(hub: Hub, attack: Attack) -> None:
    public, secret = zmq.curve_keypair()
    own = {"public": public.decode(), "secret": secret.decode()}
    expelled = hub.admit(TARGETS)
    hub.expel(expelled["public"])
    strangers = [attack({**hub.admit(TARGETS), **own}), attack(expelled)]
    for stranger in strangers:
        stranger.send(targets(np.full((2, 4), 6.0)))
    assert heard(hub) == ([], [])
    still_works(hub, attack)


def test_3_the_sockets_are_in_a_folder_of_this_user_alone(bench: EpisodesBench) -> None:
    hub = Hub(Wire(bench.geometry), [], [])
    address = hub.admit(TARGETS)["results"]
    if not address.startswith("ipc://"):
        pytest.skip("this platform's ZeroMQ has no ipc")
    folder = Path(address.removeprefix("ipc://")).parent
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    if os.getuid() == 0:  # as somebody else, the file cannot even be opened
        code = f"""
import os, socket
os.setuid(65534)
socket.socket(socket.AF_UNIX).connect({address.removeprefix("ipc://")!r})"""
        run = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False)
        assert b"PermissionError" in run.stderr
    hub.close()
    assert not folder.exists()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (targets(np.full((2, 4), np.nan)), "every value must be finite"),
        (targets(np.zeros((3, 4))), "must be"),
        (targets(np.zeros((2, 4)), source="policy"), "not the owner"),
        (targets(np.zeros((2, 4)), time=-1.0), "stamp="),
        (targets(np.zeros((2, 4)), time=np.nan), "now=nan"),
        (targets(np.zeros((2, 3)), topic="action"), "not the owner"),
        (targets(np.zeros((2, 3)), topic="action", source=""), "not the owner"),
        (targets(np.zeros((2, 3)), topic="nothing"), "topic 'nothing': must be one of"),
        (b"arms", "topic ''"),
        (packed(b"joint_targets", b"[" * 60_000), "JSON"),
        (packed(b"joint_targets", b" " * 70_000), "bytes: must be 65536 at most"),
        (packed(b"joint_targets", b'{"now": 1' + b"0" * 400 + b"}"), "now="),
        (sign(faults=3), "sign of life"),
        (sign(faults={"kinematics": 3}), "sign of life"),
        (sign(stages={"kinematics": ["x", None]}), "sign of life"),
        (sign(events=[["stopped", 1, 2]]), "sign of life"),
        (sign(events=7), "sign of life"),
    ],
)
def test_4_what_is_no_message_is_refused_from_a_process_with_keys(
    hub: Hub, attack: Attack, content: bytes, words: str
) -> None:
    insider = attack(hub.admit(TARGETS))
    insider.send(content)
    end = time.monotonic() + 20
    while not hub.refused and time.monotonic() < end:
        assert heard(hub, 0.02) == ([], [])
    assert words in hub.refused[0]
    still_works(hub, attack)


def test_5_a_huge_message_is_not_received(hub: Hub, attack: Attack) -> None:
    code = """
import json, sys, time, zmq
from saver_advisors.integration.hub import open_socket
socket = open_socket(zmq.Context(), zmq.PUSH, -1, json.load(sys.stdin))
socket.connect(sys.argv[1])
for size in (2**29, 2**24):  # encryption copies the message
    socket.send_multipart([b"x", bytes(size)])  # the rest of a message never arrives
    time.sleep(2)
"""
    keys, before = hub.admit(TARGETS), memory()
    with subprocess.Popen(
        [sys.executable, "-c", code, keys["results"]], stdin=subprocess.PIPE
    ) as process:
        assert process.stdin is not None
        process.stdin.write(json.dumps(keys).encode())
        process.stdin.close()
        while process.poll() is None:
            assert heard(hub, 0.2) == ([], [])
    still_works(hub, attack)
    assert memory() - before < MOST_MEMORY


def test_6_a_flood_stops_neither_the_hub_nor_costs_memory(hub: Hub, attack: Attack) -> None:
    insider, stop = attack(hub.admit(TARGETS)), threading.Event()
    content = targets(np.full((2, 4), 0.5))

    def flood() -> None:
        while not stop.is_set():
            insider.send(content)

    thread = threading.Thread(target=flood)
    before = memory()
    thread.start()
    try:
        for _ in range(200):
            assert len(list(hub.received(lambda key, one: None))) <= 64
        assert heard(hub, 0.5)[0]
    finally:
        stop.set()
        thread.join()
    assert memory() - before < MOST_MEMORY


def test_7_silent_connections_do_not_keep_others_out(hub: Hub, attack: Attack) -> None:
    address = hub.admit(TARGETS)["results"]
    if not address.startswith("ipc://"):
        pytest.skip("this platform's ZeroMQ has no ipc")
    before, silent = memory(), []
    for number in range(200):
        silent.append(socket.socket(socket.AF_UNIX))
        silent[-1].connect(address.removeprefix("ipc://"))
        if number % 2:
            silent[-1].send(os.urandom(200))
    still_works(hub, attack)
    for one in silent:
        one.close()
    assert memory() - before < MOST_MEMORY


class Evil(LoopStage):
    """Takes the place of the kinematics; sends what `wanted` returns."""

    def __init__(self, wanted: Callable[[ArmReading, float], Message]) -> None:
        super().__init__("kinematics", "joint_targets", ("arms",))
        self._wanted = wanted

    def process(self, inputs: Inputs, now: float) -> Message:
        return self._wanted(inputs.latest("arms", ArmReading), now)


def sent(joints: object, arms: ArmReading) -> JointTargets:
    return JointTargets(Stamp(arms.stamp.time, 1, "kinematics"), np.asarray(joints))


def tipped(arms: ArmReading, way: tuple[float, float, float], length: float) -> np.ndarray:
    """Joint targets that lead both tools along a way, the second one mirrored."""
    leads = np.array([way, (way[0], -way[1], way[2])]) * length
    return arms.joint_position + least_squares_step(arms.jacobian[:, :3], leads, 1e-4)


@pytest.fixture(scope="module")
def wrists() -> Iterator[WristBench]:
    bench = WristBench()
    yield bench
    bench.close()


NEVER = {
    "far away": lambda arms, now: sent(np.full((2, 4), 6.0), arms),
    "not a number": lambda arms, now: sent(np.full((2, 4), np.nan), arms),
    "wrong shape": lambda arms, now: sent(np.zeros((3, 4)), arms),
    "wrong class": lambda arms, now: ServoCommand(
        Stamp(arms.stamp.time, 1, "kinematics"), np.zeros((2, 4)), False, ""
    ),
    "beyond a joint limit": lambda arms, now: sent(
        np.where(np.arange(4) == 2, 0.6, arms.joint_position), arms
    ),
    "from the future": lambda arms, now: JointTargets(
        Stamp(1e9, 1, "kinematics"), arms.joint_position
    ),
    "at no time": lambda arms, now: JointTargets(
        Stamp(np.nan, 1, "kinematics"), arms.joint_position
    ),
    "too far": lambda arms, now: sent(tipped(arms, (1.0, 0.0, 0.0), 0.03), arms),
    "into the table": lambda arms, now: sent(tipped(arms, (0.0, 0.0, -1.0), 0.015), arms),
}


def attacked(
    wrists: WristBench, wanted: Callable[[ArmReading, float], Message], seed: int = 0
) -> tuple[list[ServoCommand], list[ArmReading]]:
    """Two seconds of a trial under attack: commands, and readings at the same times."""
    settings = replace(settings_for("expert"), seeing=False, learned_kinematics=False)
    loop = build_loop(
        settings,
        wrists,
        lambda stages: [Evil(wanted) if one.name == "kinematics" else one for one in stages],
    )
    commands: list[ServoCommand] = []
    readings: list[ArmReading] = []

    def watch(topic: str, message: Message, now: float) -> None:
        if topic == "servo" and isinstance(message, ServoCommand):
            commands.append(message)
            readings.append(wrists.reading())

    loop.reset(seed)
    wrists.taken_peaks()
    loop.graph.observers.append(watch)
    loop.graph.run_until(2.0, wrists.advance_to)
    return commands, readings


@pytest.mark.parametrize("name", NEVER)
def test_8_the_servo_stage_refuses_targets_that_nobody_may_send(
    wrists: WristBench, name: str
) -> None:
    commands, readings = attacked(wrists, NEVER[name])
    assert len(commands) == 500, "the loop goes on"
    assert all(one.holding and one.cause.startswith(("kinematics", "servos")) for one in commands)
    moved = np.abs(readings[-1].joint_position - readings[0].joint_position)
    assert moved.max() < 2e-3
    assert wrists.taken_peaks()[0] == 0.0


PATIENT = {
    "inwards": lambda arms, now: sent(tipped(arms, (0.0, 1.0, 0.0), 0.0195), arms),
    "along": lambda arms, now: sent(
        tipped(arms, (float(np.sign(np.sin(9 * now))), 0.0, 0.0), 0.0195), arms
    ),
    "a spinning hand": lambda arms, now: sent(
        arms.joint_position + np.array([0.0, 0.0, 0.0, 0.2]), arms
    ),
}


@pytest.mark.parametrize("seed", [0, 3])
@pytest.mark.parametrize("name", PATIENT)
def test_9_targets_that_are_each_allowed_stay_within_the_limits(
    wrists: WristBench, name: str, seed: int
) -> None:
    _, readings = attacked(wrists, PATIENT[name], seed)
    robot = wrists.geometry.robot
    joints = np.array([one.joint_position for one in readings])
    tools = np.array([one.tool_position for one in readings])
    assert (joints >= robot.joint_lower).all()
    assert (joints <= robot.joint_upper).all()
    fastest = JOINT_EXCESS * np.asarray(robot.joint_speed_limits)
    # After a rest, an arm may move more at once; on average it may not.
    for steps, excess in ((10, 1 + BURST), (100, 1 + BURST / 10)):
        seconds = 0.004 * steps
        turned = np.abs(joints[steps:] - joints[:-steps]).max(axis=(0, 1)) / seconds
        assert (turned <= excess * fastest).all()
        moved = np.linalg.norm(tools[steps:] - tools[:-steps], axis=-1).max() / seconds
        assert moved <= excess * 0.2 * 1.05
    force, displacement = wrists.taken_peaks()
    assert force <= 50.0
    assert displacement <= 0.02


def test_10_old_targets_do_not_free_the_arms(make_loop: Callable[..., SmallLoop]) -> None:
    loop = make_loop(Push((1.0, 0.0, 0.0)))
    loop.graph.run_until(0.3, loop.bench.advance_to)
    old = loop.graph.boxes["joint_targets"].latest
    assert isinstance(old, JointTargets)
    loop.stop.press("a test")
    loop.graph.run_until(0.5, loop.bench.advance_to)
    loop.stop.release()
    held = loop.bench.joint_position()
    for _ in range(3):
        loop.graph.publish("joint_targets", old, loop.graph.now)
        loop.graph.run_until(loop.graph.now + 0.001, loop.bench.advance_to)
        np.testing.assert_allclose(loop.bench.joint_position(), held, atol=2e-3)


@pytest.mark.slow
def test_11_the_loop_in_processes_goes_on_under_attack(
    bench: EpisodesBench, attack: Attack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Modules of the current folder would take the place of installed ones.
    for name in ("zmq", "numpy", "saver_advisors", "dataclasses"):
        (tmp_path / f"{name}.py").write_text("open('taken', 'w').close(); raise SystemExit(3)\n")
    monkeypatch.chdir(tmp_path)
    settings = replace(SETTINGS, silent_periods=25.0)
    with ProcessLoop(settings, bench, {"moving": ("kinematics",)}) as apart:
        insider = attack(apart.hub.admit(TARGETS))
        stranger = attack(apart.hub.admit(TARGETS), bare=True)
        apart.loop.reset(0)
        start = bench.joint_position()
        apart.run_until(0.4)
        before = memory()  # the loop itself has what it needs by now
        for step in range(10, 50):
            now = step / 25
            for attacker in (insider, stranger):
                attacker.send(targets(np.full((2, 4), 6.0), time=now))
                attacker.send(targets(np.zeros((3, 4)), time=now))
                attacker.send(targets(np.full((2, 4), 0.5), time=now + 5.0))
                attacker.send(sign(faults=3))
                attacker.send(bytes(200_000))  # more would be kept by this process, which sends
            apart.run_until(now + 0.04)
        first = bench.joint_position()
        end = 2.0
        while np.abs(bench.joint_position() - first).max() < 0.01 and end < 30.0:
            end += 0.2
            apart.run_until(end)
        assert np.abs(bench.joint_position() - start).max() > 0.01, "the policy drives the arms"
        assert np.abs(bench.joint_position()).max() < 6.0
        assert not any(event.kind == "crashed" for event in apart.loop.health.log)
        assert apart.hub.refused
        assert memory() - before < MOST_MEMORY
    assert not (tmp_path / "taken").exists()


def test_12_the_log_does_not_grow_without_end() -> None:
    from saver_advisors.integration.health import LONGEST_LOG, Health

    health = Health(["policy"], {})
    for number in range(LONGEST_LOG + 10):
        health.note(float(number), "limited", "policy", "force")
    assert len(health.log) == LONGEST_LOG
