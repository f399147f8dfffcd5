"""Commands that are interrupted: by Ctrl-C during training, and by a closed pipe."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from commands import TINY, tiny_train

from saver_advisors.cli import main

SAVER = (sys.executable, "-m", "saver_advisors.cli")


def wait_for_content(path: Path, seconds: float) -> None:
    """Wait until a file has been written to."""
    deadline = time.monotonic() + seconds
    while not (path.exists() and path.stat().st_size):
        assert time.monotonic() < deadline, f"nothing was written to {path}"
        time.sleep(0.1)


@pytest.mark.long
def test_an_interrupted_run_goes_on(tmp_path: Path) -> None:
    assert "checkpoint_every=20" in TINY
    folder = tmp_path / "run"
    command = [str(word) for word in (*SAVER, *tiny_train(folder), "--steps", 1_000_000)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    process = subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        wait_for_content(folder / "curve.jsonl", 240)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=120)
    finally:
        process.kill()
    assert process.returncode == 130, err
    assert f"saver train --output {folder} --resume" in out
    assert "Traceback" not in err
    lines = (folder / "curve.jsonl").read_text().splitlines()
    steps = json.loads(lines[-1])["steps"]
    resume = [*SAVER, "train", "--output", str(folder), "--resume", "--no-progress"]
    completed = subprocess.run(
        [*resume, "--steps", str(steps + 60)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert completed.returncode == 0, completed.stderr
    sessions = json.loads((folder / "run.json").read_text())["sessions"]
    assert len(sessions) == 2
    assert sessions[1]["from_steps"] >= steps
    curve = [json.loads(line)["steps"] for line in (folder / "curve.jsonl").open()]
    assert curve == sorted(set(curve)), "no evaluation is lost or doubled"
    assert curve[-1] == steps + 60


def test_a_closed_pipe_ends_a_command_quietly(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in `saver envs | head -1`."""
    redirected = []

    def run(_: object) -> int:
        raise BrokenPipeError(errno.EPIPE, "Broken pipe")

    monkeypatch.setattr("saver_advisors.cli.envs.run", run)
    monkeypatch.setattr(os, "dup2", lambda *pair: redirected.append(pair))
    assert main(["envs"]) == 0
    assert redirected
