"""A run's folder: one process at a time, damage is refused, and nothing is overwritten."""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tiny_runs import TINY_RUN, write_settings

from saver_advisors.cli import main
from saver_advisors.training.checkpoint import _checksum, _file_checksum, read_state
from saver_advisors.training.curve_file import read_curve
from saver_advisors.training.launch import load_trained, train
from saver_advisors.training.run_folder import FolderInUseError, locked, read_record
from saver_advisors.training.settings import AdviceConfig, RunConfig
from saver_envs.digest import world_digest
from saver_envs.files import read_json, written_whole

CONFIG = replace(TINY_RUN, checkpoint_every=20)
LONGER = replace(CONFIG, total_steps=60)
FILES = ("policy.safetensors", "training.safetensors", "replay.npz", "state.json")


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("finished") / "run"
    train(CONFIG, folder, progress=False)
    return folder


@pytest.fixture
def run(finished: Path, tmp_path: Path) -> Path:
    """A finished run, to damage."""
    return Path(shutil.copytree(finished, tmp_path / "run"))


def resume(folder: Path, config: RunConfig = LONGER) -> Any:
    return train(config, folder, resume=True, progress=False)


def content_of(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


# One process -------------------------------------------------------------------------------------


@pytest.fixture
def owner(run: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that has the folder."""
    code = (
        "import sys, pathlib; from saver_advisors.training.run_folder import locked\n"
        "with locked(pathlib.Path(sys.argv[1])): print('has it', flush=True); sys.stdin.read()"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(run)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "has it\n"
    yield process
    process.kill()
    process.communicate()


def test_a_second_process_is_refused_and_a_dead_one_does_not_block(
    run: Path, owner: subprocess.Popen[str], capsys: pytest.CaptureFixture[str]
) -> None:
    before = content_of(run)
    with pytest.raises(FolderInUseError, match=rf"{run} is in use by process {owner.pid} on "):
        resume(run)
    assert main(["train", "--output", str(run), "--resume", "--no-progress"]) == 2
    assert f"process {owner.pid}" in capsys.readouterr().err
    assert content_of(run) == before
    owner.kill()
    owner.communicate()
    assert resume(run).finished
    assert not (run / ".lock-owner").exists()


def test_a_thread_may_lock_its_folder_again(tmp_path: Path) -> None:
    with locked(tmp_path), locked(tmp_path):
        pass
    with locked(tmp_path):
        assert (tmp_path / ".lock-owner").read_text().startswith(f"process {os.getpid()} on ")


# Resuming ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("gone", ["latest", "latest/state.json"])
def test_without_its_checkpoint_a_run_is_not_begun_afresh(
    run: Path, gone: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = run / gone
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    before = content_of(run)
    assert main(["train", "--output", str(run), "--resume", "--no-progress"]) == 2
    error = capsys.readouterr().err
    assert "latest/state.json is missing" in error
    assert "restore the folder 'latest'" in error
    assert content_of(run) == before


def test_a_run_has_a_checkpoint_from_its_first_step(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def crash(*_: Any, **__: Any) -> Any:
        assert (tmp_path / "curve.jsonl").read_text() == ""
        raise KeyboardInterrupt

    with monkeypatch.context() as changed, pytest.raises(KeyboardInterrupt):
        changed.setattr("saver_advisors.training.run.evaluate_policy", crash)
        train(CONFIG, tmp_path, progress=False)
    assert read_state(tmp_path / "latest")["steps"] == 0
    assert resume(tmp_path, CONFIG).finished
    assert [one["from_steps"] for one in read_record(tmp_path)["sessions"]] == [0, 0]


# Damage ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", FILES)
def test_no_flipped_bit_is_accepted(run: Path, name: str) -> None:
    path = run / "latest" / name
    whole = path.read_bytes()
    random = np.random.default_rng(0)
    for bit in random.integers(0, 8 * len(whole), 40):
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << (bit % 8)
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match=name.replace(".", r"\.")):
            resume(run)
    path.write_bytes(whole)
    assert resume(run).finished


def test_a_missing_file_of_a_checkpoint_is_named(run: Path) -> None:
    (run / "latest" / "replay.npz").unlink()
    with pytest.raises(FileNotFoundError, match=r"replay\.npz is missing"):
        resume(run)


def seal(checkpoint: Path) -> None:
    """Give a checkpoint the checksums of its files, as if they had been written so."""
    path = checkpoint / "state.json"
    state = json.loads(path.read_text())
    del state["sha256"]
    state["files"] = {name: _file_checksum(checkpoint / name) for name in state["files"]}
    path.write_text(json.dumps({**state, "sha256": _checksum(state)}))


def test_a_checkpoint_without_checksums_is_refused(run: Path) -> None:
    path = run / "latest" / "state.json"
    state = json.loads(path.read_text())
    del state["sha256"], state["files"]
    path.write_text(json.dumps(state))
    with pytest.raises(ValueError, match=r"state\.json .* lacks \['files', 'sha256'\]"):
        resume(run)


@pytest.mark.parametrize("name", ["observation", "slot", "header"])
def test_a_small_file_that_holds_a_large_array_is_refused_unread(
    run: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = run / "latest" / "replay.npz"
    with zipfile.ZipFile(path) as archive:
        members = {one: archive.read(one) for one in archive.namelist()}
    kind = "<U9000000" if name == "header" else "<f4"
    shape = () if name == "header" else (10**6, 51, 28)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for one, content in members.items():
            with archive.open(one, "w") as file:
                if one == f"{name}.npy":
                    header = {"descr": kind, "fortran_order": False, "shape": shape}
                    np.lib.format.write_array_header_1_0(file, header)
                else:
                    file.write(content)
    seal(path.parent)
    read = np.lib.npyio.NpzFile.__getitem__
    sizes = []

    def keep(*arguments: Any, **named: Any) -> Any:
        array = read(*arguments, **named)
        sizes.append(array.nbytes)
        return array

    monkeypatch.setattr(np.lib.npyio.NpzFile, "__getitem__", keep)
    with pytest.raises(ValueError, match=rf"replay\.npz: (its )?{name}"):
        resume(run)
    assert sum(sizes) < 10**5


DEEP = "[" * 100_000
RECORDS = {"empty": "{}", "deep": DEEP, "list": "[]", "number": '{"config": 3, "sessions": [{}]}'}


@pytest.mark.parametrize("record", RECORDS)
@pytest.mark.parametrize(
    "words",
    [
        ("train", "--output", "RUN", "--resume"),
        ("evaluate", "--env", "JacoPush-v0", "--policy", "RUN"),
        ("export", "RUN", "--path", "policy.safetensors"),
        ("curves", "RUN"),
    ],
)
def test_a_damaged_record_is_one_line(
    run: Path,
    record: str,
    words: tuple[str, ...],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(run.parent)
    (run / "run.json").write_text(RECORDS[record])
    assert main([str(run) if word == "RUN" else word for word in words]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "run.json" in error


@pytest.mark.parametrize("line", ["{}", "5", '{"steps": "many"}', DEEP, '{"steps": 1}'])
def test_a_line_that_is_no_point_is_named_and_kept(
    run: Path, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = run / "curve.jsonl"
    first, second = path.read_text().splitlines()
    path.write_text(f"{first}\n{line}\n{second}\n")
    before = path.read_bytes()
    with pytest.raises(ValueError, match=r"curve\.jsonl: line 2"):
        resume(run)
    assert main(["curves", str(run)]) == 2
    assert "line 2" in capsys.readouterr().err
    assert path.read_bytes() == before
    path.write_text(f"{first}\n{second[:20]}")
    assert len(read_curve(run)) == 1, "a crash may leave half a line at the end"


def test_a_policy_whose_name_is_too_long_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    for word in ("a" * 5_000, "a" * 5_000 + ".zip", "side-by-side:" + "a" * 5_000):
        assert main(["evaluate", "--env", "JacoPush-v0", "--policy", word]) == 2
        assert capsys.readouterr().err.count("\n") == 1


# Code that a file names --------------------------------------------------------------------------


@pytest.fixture
def spy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A module `spying` with a strategy and a teacher; the returned file appears on import."""
    mark = tmp_path / "imported"
    (tmp_path / "spying.py").write_text(
        f"import pathlib\npathlib.Path({str(mark)!r}).touch()\n"
        "from saver_advisors.advising.strategies import EarlyAdvising as Strategy\n"
        "def teacher(observation, goal):\n"
        "    return (goal - observation[:, :3]).clip(-1, 1)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "spying", raising=False)
    return mark


NAMED = {
    "strategy": AdviceConfig("spying:Strategy", "jaco-push", 100),
    "teacher": AdviceConfig("early", "spying:teacher", 100),
}


@pytest.mark.parametrize("named", NAMED)
def test_code_is_imported_once_all_else_is_accepted(
    named: str, spy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config, run = replace(CONFIG, advice=NAMED[named]), tmp_path / "run"
    wrong = {"buffer_size": 3, "env_kwargs": {"max_episode_steps": 10, "object_mas": 1.0}}
    for name, value in wrong.items():
        with pytest.raises((ValueError, TypeError), match=name if name != "env_kwargs" else "mas"):
            train(replace(config, **{name: value}), run, progress=False)
        assert not spy.exists(), name
    assert train(config, run, progress=False, stop_after_steps=20).steps == 20
    assert spy.exists()
    spy.unlink()
    sys.modules.pop("spying")
    path = run / "latest" / "replay.npz"
    path.write_bytes(path.read_bytes()[:-1])
    assert main(["train", "--output", str(run), "--resume", "--no-progress"]) == 2
    assert "replay.npz" in capsys.readouterr().err
    assert not spy.exists(), "the checkpoint is damaged"


def test_the_module_of_an_environment_is_imported_after_the_policy_is_read(
    run: Path, spy: Path
) -> None:
    record = json.loads((run / "run.json").read_text())
    assert record["world"] == world_digest(CONFIG.env_id, CONFIG.env_kwargs)
    record["config"]["env_id"] = "spying:Mine-v0"
    (run / "run.json").write_text(json.dumps(record))
    path = run / "best" / "policy.safetensors"
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(ValueError, match=r"policy\.safetensors"):
        load_trained(run)
    assert not spy.exists()


# Disks -------------------------------------------------------------------------------------------


def test_what_a_full_disk_left_unwritten_is_named(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    before = content_of(run)
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(OSError, match=r"curve\.jsonl could not be written \(No space left"):
            resume(run)
        with pytest.raises(OSError, match=r"fresh/curve\.jsonl could not be written"):
            train(CONFIG, tmp_path / "fresh", progress=False)
        with (
            pytest.raises(OSError, match=r"a\.json could not be written"),
            written_whole(tmp_path / "a.json") as file,
        ):
            file.write(b"{}")
    assert content_of(run) == before
    assert resume(run).finished


@pytest.mark.skipif(os.name == "nt", reason="limits of a process")
def test_a_run_on_a_disk_that_fills_up_says_so(tmp_path: Path) -> None:
    """A limit on the size of files stands for the disk: the checkpoint does not fit."""
    code = (
        "import resource, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "from saver_advisors.cli import main\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (8_000, 8_000))\n"
        "sys.exit(main(sys.argv[1:]))"
    )
    path = tmp_path / "run.yml"
    write_settings(CONFIG, path)
    words = ["train", "--config", str(path), "--output", str(tmp_path / "run"), "--no-progress"]
    done = subprocess.run(
        [sys.executable, "-c", code, *words], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2, done.stderr
    assert "the checkpoint" in done.stderr
    assert "could not be written (File too large)" in done.stderr
    assert "Traceback" not in done.stderr
    assert main([*words]) == 2, "the folder holds a run"
    assert main([*words, "--resume"]) == 0


def test_a_folder_that_cannot_be_written_to_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match=r"file/run cannot be written to \(Not a directory\)"):
        train(CONFIG, tmp_path / "file" / "run", progress=False)


def test_json_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    for content in (b"{", DEEP.encode(), b"\xff\xfe"):
        (tmp_path / "a.json").write_bytes(content)
        with pytest.raises(ValueError, match=r"a\.json is truncated or not JSON"):
            read_json(tmp_path / "a.json")
