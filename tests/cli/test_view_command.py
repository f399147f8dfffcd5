"""`saver view`: mistakes of the user, and watching a policy."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest
from commands import Saver

pytest.importorskip("viser")
pytest.importorskip("minari")

ENV = ("view", "--env", "JacoPush-v0", "--env-kwargs", "max_episode_steps=3")
HAND = (*ENV, "--control", "keyboard")


def test_watch_a_policy(saver: Saver) -> None:
    result = saver(*ENV, "--policy", "random", "--port", 0, "--episodes", 1, "--speed", 50)
    assert result.status == 0, result.err
    assert "open http://127.0.0.1:" in result.out


CASES = {
    "no environment": (["view"], ["--env"]),
    "unknown policy": ([*ENV, "--policy", "best"], ["--policy", "'best'", "jaco-push"]),
    "policy of another size": (
        ["view", "--env", "DualJacoPush-v0", "--policy", "jaco-push"],
        ["fit"],
    ),
    "no such arm": ([*HAND, "--arm", 1], ["--arm", "arm=1", "0 to 0"]),
    "joints": ([*HAND, "--policy", "random", "--env-kwargs", "control=joints"], ["'cartesian'"]),
    "speed": ([*ENV, "--speed", 0], ["--speed", "more than 0"]),
    "port": ([*ENV, "--port", 70000], ["--port", "70000"]),
    "host": ([*ENV, "--host", "203.0.113.7"], ["--host", "203.0.113.7"]),
    "record a policy": (
        [*ENV, "--record", "a/b-v0"],
        ["--record", "--control keyboard", "dataset"],
    ),
    "name of Minari": ([*HAND, "--record", "a b"], ["--record", "a b", "-vVERSION"]),
    "folder for nothing": ([*HAND, "--output", "sets"], ["--record", "--output"]),
    "window": ([*ENV, "--window"], ["--window", "no display"]),
}


@pytest.mark.parametrize(("words", "wanted"), CASES.values(), ids=CASES)
def test_mistakes(
    words: list[object],
    wanted: list[str],
    saver: Saver,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    result = saver(*words)
    assert result.status == 2
    assert len(result.err.strip().splitlines()) == 1, result.err
    for text in wanted:
        assert text in result.err


def test_a_busy_port(saver: Saver) -> None:
    with socket.create_server(("127.0.0.1", 0)) as busy:
        port = busy.getsockname()[1]
        result = saver(*ENV, "--port", port)
    assert result.status == 2
    assert f"127.0.0.1:{port} cannot be listened on" in result.err


def test_a_data_set_that_exists(saver: Saver, tmp_path: Path) -> None:
    (tmp_path / "mine-v0").mkdir()
    result = saver(*HAND, "--record", "mine-v0", "--output", tmp_path)
    assert result.status == 2
    assert "exists: choose another id" in result.err
