"""Mistakes of the user: exit status 2, and one line that says what was wrong and would be right."""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path

import pytest
from commands import Saver, tiny_train

from saver_advisors.cli import SAVER
from saver_advisors.cli.program import missing_extra

CASES = {
    "unknown command": (["evaluat"], ["evaluat", "evaluate"]),
    "shield without a constraint": (
        ["evaluate", "--env", "JacoPush-v0", "--policy", "random", "--shield"],
        ["--shield", "JacoPush-v0", "no constraint"],
    ),
    "unknown environment": (
        ["evaluate", "--env", "JacoPusch-v0", "--policy", "random"],
        ["--env", "'JacoPusch-v0'", "did you mean JacoPush-v0", "DualJacoDistance-v0"],
    ),
    "unknown policy": (
        ["evaluate", "--env", "JacoPush-v0", "--policy", "jaco-pusch"],
        ["--policy", "'jaco-pusch'", "did you mean jaco-push", "side-by-side:TEACHER"],
    ),
    "missing weight file": (
        ["evaluate", "--env", "JacoPush-v0", "--policy", "none.safetensors"],
        ["--policy", "none.safetensors"],
    ),
    "policy of another size": (
        ["evaluate", "--env", "DualJacoPush-v0", "--policy", "jaco-push"],
        ["--policy", "'jaco-push'", "DualJacoPush-v0", "observation 28", "observation 56"],
    ),
    "side by side without a teacher": (
        ["evaluate", "--env", "DualJacoPush-v0", "--policy", "side-by-side:"],
        ["side-by-side:jaco-push"],
    ),
    "teacher of another task": (
        ["evaluate", "--env", "DualJacoPickAndPlace-v0", "--policy", "side-by-side:jaco-push"],
        ["side-by-side:jaco-push", "action 6", "action 8"],
    ),
    "frozen arm of one": (
        ["evaluate", "--env", "JacoPush-v0", "--policy", "frozen-arm"],
        ["frozen-arm", "two arms"],
    ),
    "frozen arm that is none": (
        ["evaluate", "--env", "DualJacoPush-v0", "--policy", "frozen-arm:2"],
        ["frozen-arm:2", "0 or 1"],
    ),
    "expert of joint motion": (
        [
            *("evaluate", "--env", "JacoPush-v0", "--policy", "expert"),
            *("--env-kwargs", "control=joints"),
        ],
        ["expert", "control='joints'"],
    ),
    "no episodes": (
        ["evaluate", "--env", "JacoPush-v0", "--policy", "random", "--episodes", "0"],
        ["--episodes", "0", "1 or more"],
    ),
    "episodes in words": (
        ["evaluate", "--env", "JacoPush-v0", "--policy", "random", "--episodes", "ten"],
        ["--episodes", "'ten'", "whole number"],
    ),
    "unknown keyword of the environment": (
        ["evaluate", "--env", "JacoPush-v0", "--policy", "random", "--env-kwargs", "horizn=3"],
        ["--env-kwargs", "'horizn'", "unexpected keyword argument", "max_speed"],
    ),
    "keyword out of range": (
        ["evaluate", "--env", "JacoPush-v0", "--policy", "random", "--env-kwargs", "max_speed=9"],
        ["--env-kwargs", "max_speed=9", "at most 2 m/s"],
    ),
    "keyword without a value": (
        ["evaluate", "--env", "JacoPush-v0", "--policy", "random", "--env-kwargs", "horizon"],
        ["--env-kwargs", "'horizon'", "name=value"],
    ),
    "result into nowhere": (
        ["evaluate", "--env", "JacoPush-v0", "--policy", "random", "--json", "no/where.json"],
        ["--json", "'no'", "does not exist"],
    ),
    "result where nothing can be written": (
        ["evaluate", "--env", "JacoPush-v0", "--policy", "random", "--json", "/proc/r.json"],
        ["--json", "'/proc'", "cannot be written to"],
    ),
    "run where nothing can be written": (
        ["train", "--env", "JacoPush-v0", "--output", "/proc/runs/push"],
        ["--output", "'/proc'", "cannot be written to"],
    ),
    "page where nothing can be written": (
        ["benchmark", "speed", "--table", "/proc/speed.md"],
        ["--table", "'/proc'", "cannot be written to"],
    ),
    "result that is no JSON file": (
        ["evaluate", "--env", "JacoPush-v0", "--policy", "random", "--json", "result.txt"],
        ["--json", "'result.txt'", ".json"],
    ),
    "training nowhere": (["train", "--env", "JacoPush-v0"], ["--output"]),
    "no thread": (
        ["train", "--env", "JacoPush-v0", "--output", "run", "--threads", "0"],
        ["--threads", "0 is too small"],
    ),
    "threads of our loop": (
        ["train", "--zoo", "sac", "--env", "JacoPush-v0", "--output", "run", "--threads", "2"],
        ["--threads", "--num-threads"],
    ),
    "logs of our loop": (
        ["train", "--zoo", "sac", "--env", "JacoPush-v0", "--output", "run", "--tensorboard"],
        ["--tensorboard", "--tensorboard-log"],
    ),
    "seeds that are none": (
        [
            *("benchmark", "run", "--env", "JacoPush-v0", "--algo", "a:B", "--output", "results"),
            *("--seeds", "4-2"),
        ],
        ["--seeds", "'4-2'", "smaller"],
    ),
    "training in nothing": (["train", "--output", "run"], ["--env", "saver envs"]),
    "unknown algorithm": (
        ["train", "--env", "JacoPush-v0", "--output", "run", "--algorithm", "ppo"],
        ["'ppo'", "td3"],
    ),
    "unknown setting": (
        ["train", "--env", "JacoPush-v0", "--output", "run", "--set", "gama=0.9"],
        ["gama", "gamma"],
    ),
    "setting of the wrong type": (
        ["train", "--env", "JacoPush-v0", "--output", "run", "--set", "n_envs=many"],
        ["n_envs='many'", "whole number"],
    ),
    "unknown strategy": (
        ["train", "--env", "DualJacoPush-v0", "--output", "run", "--advice", "late"],
        ["--advice", "'late'", "early", "mc-q"],
    ),
    "unknown teacher": (
        ["train", "--env", "DualJacoPush-v0", "--output", "run", "--teacher", "jaco-pull"],
        ["--teacher", "'jaco-pull'", "jaco-push"],
    ),
    "advice without a budget": (
        [
            *("train", "--env", "JacoPush-v0", "--output", "run"),
            *("--advice", "early", "--teacher", "jaco-push"),
        ],
        ["--budget"],
    ),
    "threshold for early advice": (
        [
            *("train", "--env", "DualJacoPush-v0", "--output", "run"),
            *(
                "--advice",
                "early",
                "--teacher",
                "jaco-push",
                "--budget",
                "100",
                "--threshold",
                "0.1",
            ),
        ],
        ["'early'", "threshold=0.1"],
    ),
    "budget where nothing is advised": (
        ["train", "--env", "DualJacoDistance-v0", "--output", "run", "--budget", "100"],
        ["--budget", "--advice"],
    ),
    "network too narrow for its teachers": (
        [
            "train",
            "--env",
            "DualJacoDistance-v0",
            "--output",
            "run",
            "--set",
            "net_arch=[64,64,64]",
        ],
        ["advice: net_arch=[64, 64, 64]", "use net_arch=[256, 256, 256]"],
    ),
    "teacher that does not fit": (
        [
            *("train", "--env", "DualJacoDistance-v0", "--output", "run"),
            *("--teacher", "jaco-push"),
        ],
        ["jaco-push", "advice"],
    ),
    "missing configuration": (
        ["train", "--config", "none.yml", "--output", "run"],
        ["--config", "none.yml"],
    ),
    "export of nothing": (
        ["export", "nothing", "--path", "a.safetensors"],
        ["'nothing'", "run.json"],
    ),
    "curves of nothing": (["curves", "nothing"], ["'nothing'", "saver train"]),
    "figure of an unknown kind": (
        ["curves", "nothing", "--output", "a.gif"],
        ["--output", "'a.gif'", ".png"],
    ),
    "time that is none": (["demo", "--train-seconds", "-3"], ["--train-seconds", "-3"]),
}


@pytest.mark.parametrize("case", CASES)
def test_one_line_says_what_is_wrong(
    saver: Saver, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, case: str
) -> None:
    monkeypatch.chdir(tmp_path)
    words, expected = CASES[case]
    result = saver(*words)
    assert result.status == 2
    assert result.out == ""
    assert result.err.count("\n") == 1, result.err
    assert "error:" in result.err
    for text in expected:
        assert text in result.err
    assert list(tmp_path.iterdir()) == [], "nothing was begun"


def test_a_run_is_not_overwritten(saver: Saver, run_dir: Path) -> None:
    before = (run_dir / "run.json").read_bytes()
    result = saver(*tiny_train(run_dir))
    assert result.status == 2
    assert "--resume" in result.err
    assert (run_dir / "run.json").read_bytes() == before


def test_a_run_of_other_settings_is_not_resumed(saver: Saver, run_dir: Path) -> None:
    result = saver(
        *("train", "--output", run_dir, "--resume", "--set", "gamma=0.9", "--no-progress")
    )
    assert result.status == 2
    assert "gamma: 0.98 -> 0.9" in result.err


def test_a_foreign_weight_file_is_refused(saver: Saver, tmp_path: Path) -> None:
    path = tmp_path / "foreign.safetensors"
    path.write_bytes(b"not weights at all")
    result = saver("evaluate", "--env", "JacoPush-v0", "--policy", path)
    assert result.status == 2
    assert "foreign.safetensors is not a complete safetensors file" in result.err


def test_a_run_without_an_evaluation_has_no_curve(
    saver: Saver, run_dir: Path, tmp_path: Path
) -> None:
    (tmp_path / "run.json").write_bytes((run_dir / "run.json").read_bytes())
    (tmp_path / "curve.jsonl").write_text("")
    result = saver("curves", tmp_path)
    assert result.status == 2
    assert "no evaluation yet" in result.err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("evaluate", "--env", "JacoPush-v0", "--policy", "FOLDER"), "policy is FOLDER/latest"),
        (("export", "FOLDER", "--path", "a.safetensors"), "argument RUN_DIR: 'FOLDER'"),
    ],
)
def test_a_run_without_an_evaluation_has_no_best_policy(
    saver: Saver, run_dir: Path, tmp_path: Path, words: tuple[str, ...], said: str
) -> None:
    shutil.copytree(run_dir, tmp_path, dirs_exist_ok=True)
    shutil.rmtree(tmp_path / "best")
    (tmp_path / "curve.jsonl").write_text("")
    result = saver(*(word.replace("FOLDER", str(tmp_path)) for word in words))
    assert result.status == 2
    assert result.err.count("\n") == 1
    assert "has no evaluation yet" in result.err
    assert said.replace("FOLDER", str(tmp_path)) in result.err


def test_a_missing_extra_is_named(saver: Saver, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(args: object) -> int:
        raise ModuleNotFoundError("No module named 'zmq'", name="zmq")

    monkeypatch.setattr("saver_advisors.cli.envs.run", missing)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    result = saver("envs")
    assert result.status == 2
    wanted = "needs the package zmq: pip install 'saver-envs[integration]'"
    assert result.err == f"saver envs: error: {wanted}\n"


@pytest.mark.parametrize(
    ("module", "usual", "extra"),
    [
        ("torch.nn", "train", "train"),
        ("torch", "modelling", "modelling"),
        ("PIL", "pose", "pose"),
        ("wandb", "train", "logging"),
        ("somebody_elses", "train", None),
        (None, "train", None),
    ],
)
def test_the_extra_of_a_module(
    monkeypatch: pytest.MonkeyPatch, module: str | None, usual: str, extra: str | None
) -> None:
    assert missing_extra(module, usual) is None, "what is installed is not missing"
    monkeypatch.setattr("importlib.util.find_spec", lambda name: name == "sys" or None)
    assert missing_extra(module, usual) == extra


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EROFS])
def test_a_full_or_read_only_disk_is_one_line(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def replace(source: object, target: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "replace", replace)
    arguments = ["evaluate", "--env", "JacoPush-v0", "--policy", "random", "--episodes", "1"]
    assert SAVER.main([*arguments, "--json", str(tmp_path / "one.json")]) == 1
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith("saver evaluate: error: ")
    assert os.strerror(number) in last
    assert not (tmp_path / "one.json").exists()
