"""The benchmark room on tiny settings: what it says, never how fast anything is."""

from __future__ import annotations

import io
import json
import os
import re
import sys
from pathlib import Path
from typing import Any

import pytest

from saver_advisors.benchmark.machine import cores, median_ratio
from saver_advisors.benchmark.peers import worker
from saver_advisors.benchmark.peers.process import PeerError
from saver_advisors.benchmark.peers.suites import (
    COMPLETE,
    ENVPOOL_PUSH,
    FETCH_PUSH,
    TWO_ARM_LIFT,
    Peer,
    RunningPeer,
    install,
)
from saver_advisors.benchmark.speed.learner_parts import advice_row
from saver_advisors.benchmark.speed.randomized_steps import randomized_row
from saver_advisors.benchmark.speed.speed_page import render
from saver_advisors.benchmark.speed.steps import memory_per_env, reset_row, step_rows
from saver_advisors.cli import main

KEYS = {"env", "n_envs", "threads", "steps_per_second", "raw_steps_per_second", "ratio_to_raw"}


def test_step_rows_say_what_was_timed() -> None:
    rounds = []
    rows = step_rows("JacoPush-v0", 2, [1, 2, 3], 2, 0.01, lambda: rounds.append(0))
    assert len(rounds) == 2
    # Three threads for two environments: one would have nothing to do.
    assert [row["threads"] for row in rows] == [1, 2]
    for row in rows:
        assert row.keys() >= KEYS
        assert (row["env"], row["n_envs"]) == ("JacoPush-v0", 2)
        assert row["raw_steps_per_second"] > 0
        assert row["ratio_to_raw"] > 0
    assert rows[0]["speed_up_of_threads"] == 1.0


def test_the_whole_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    figures, page = tmp_path / "speed.json", tmp_path / "speed.md"
    words = "benchmark speed --envs DualJacoPush-v0 --n-envs 1 2 --threads 1 --rounds 1"
    tiny = [*words.split(), "--seconds", "0.01"]
    assert main([*tiny, "--json", str(figures), "--table", str(page)]) == 0
    content = json.loads(figures.read_text())
    assert [row["n_envs"] for row in content["rows"]] == [1, 2]
    (varied,) = content["randomized"]
    assert (varied["env"], varied["n_envs"], varied["identical"]) == ("DualJacoPush-v0", 2, True)
    assert content["replay"]["rows"] == 200_000
    assert {one["strategy"] for one in content["advice"]} == {"early", "mc-q"}
    assert content["provenance"].keys() >= {"command", "commit", "versions", "machine"}
    text = page.read_text()
    assert "DualJacoPush-v0" in text
    assert f"{content['rows'][1]['steps_per_second']:,.0f}" in text
    # The page is a rendering of the file and of nothing else.
    capsys.readouterr()
    assert main(["benchmark", "speed", "--from", str(figures)]) == 0
    assert capsys.readouterr().out.strip() == text.strip()


@pytest.mark.parametrize("text", ['{"rows": [', "[]", '{"kind": "evaluation"}'])
def test_a_file_that_is_no_measurement_is_named(
    text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "cut.json"
    path.write_text(text)
    assert main(["benchmark", "speed", "--from", str(path)]) == 2
    assert str(path) in capsys.readouterr().err


def test_advice_is_timed_beside_the_step() -> None:
    row = advice_row("mc-act", rounds=1, seconds=0.04)
    assert (row["n_envs"], row["arms"]) == (16, 2)
    assert row["milliseconds"] > 0
    assert row["share_of_step"] > 0


def test_resets_and_memory() -> None:
    row = reset_row("JacoPush-v0", rounds=1)
    assert set(row["milliseconds_per_episode"]) == {"1", "64"}
    found = memory_per_env("JacoPush-v0", [1, 32])
    assert set(found) <= {32}
    if sys.platform == "linux":
        assert found[32] is not None
        assert 0.0 < found[32] < 50.0


@pytest.mark.parametrize(
    "env_id",
    ["JacoPickAndPlace-v0", pytest.param("WristPush-v0", marks=pytest.mark.slow)],
)
def test_worlds_with_nominal_values_are_the_default_one(env_id: str) -> None:
    rounds = []
    row = randomized_row(env_id, 2, 1, lambda: rounds.append(0))
    assert len(rounds) == 1
    assert row["identical"]
    rates = ("steps_per_second", "nominal", "wide", "raw_steps_per_second", "wide_to_raw", "reset")
    assert all(row[name] > 0 for name in rates)
    assert set(row["memory_per_env_mb"]) == {"default", "wide"}


def test_the_page_has_the_bars_of_worlds_that_vary() -> None:
    docs = Path(__file__).resolve().parents[2] / "docs"
    figures = json.loads((docs / "results" / "speed.json").read_text())
    row = {
        **{"env": "JacoPush-v0", "n_envs": 64, "steps_per_second": 5000.0, "nominal": 0.985},
        **{"identical": False, "wide": 0.9, "raw_steps_per_second": 5200.0, "wide_to_raw": 0.94},
        **{"reset": 1.25, "memory_per_env_mb": {"default": 0.2, "wide": 0.3}},
    }
    text = render({**figures, "randomized": [row]})
    assert "| nominal (at least 0.94) | identical |" in text
    assert "| JacoPush-v0 | 64 | 5,000 | 0.98 | no | 0.90 | 5,200 | 0.94 | 1.25x | 1.50x |" in text
    row["memory_per_env_mb"] = {"default": None, "wide": None}
    assert "| 1.25x | - |" in render({**figures, "randomized": [row]})


def test_ratios_are_taken_round_by_round() -> None:
    # The second round was disturbed: both parts took ten times as long.
    assert median_ratio([1.0, 10.0, 1.0], [2.0, 20.0, 2.0]) == 0.5


def test_cores_are_given_back() -> None:
    if not hasattr(os, "sched_getaffinity"):
        pytest.skip("the system does not say which cores a thread may use")
    before = os.sched_getaffinity(0)
    with cores(1):
        assert len(os.sched_getaffinity(0)) == 1
    assert os.sched_getaffinity(0) == before


@pytest.mark.parametrize(
    "peer", [TWO_ARM_LIFT, ENVPOOL_PUSH, Peer("NoSuchEnv", "robosuite", 1, ())]
)
def test_a_peer_that_does_not_start_says_why(peer: Peer) -> None:
    with pytest.raises(PeerError, match=rf"{re.escape(peer.name)} does not run: .*{peer.suite}"):
        RunningPeer(peer, Path(sys.executable))


def test_a_peer_that_cannot_be_installed_is_named(tmp_path: Path) -> None:
    peer = Peer("Env", "suite", 1, (str(tmp_path / "no-such-wheel.whl"),))
    with pytest.raises(PeerError, match="suite cannot be installed"):
        install(peer, tmp_path / "cache")
    assert not (tmp_path / "cache" / "suite" / COMPLETE).exists()


def test_a_peer_is_installed_once(tmp_path: Path) -> None:
    folder = tmp_path / FETCH_PUSH.suite
    folder.mkdir()
    (folder / COMPLETE).write_text(json.dumps(FETCH_PUSH.requirements))
    assert install(FETCH_PUSH, tmp_path).is_relative_to(folder)


def test_the_worker_counts_whole_pieces(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    done: list[str] = []
    work: Any = ({"one": lambda: done.append("one")}, 7)
    monkeypatch.setattr(sys, "stdin", io.StringIO("one 0\none 0.01\n"))
    worker.serve(work, {"mujoco": "3"})
    ready, first, second = (json.loads(line) for line in capsys.readouterr().out.splitlines())
    assert ready == {"ready": True, "modes": ["one"], "versions": {"mujoco": "3"}}
    assert first > 0
    # Without the piece to warm up and the one for the first line.
    assert second * 7 * (len(done) - 2) >= 0.01
