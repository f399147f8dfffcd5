"""A run: its curve, its checkpoints, and that resuming changes nothing."""

from __future__ import annotations

import dataclasses
import errno
import json
import os
import shutil
import signal
import threading
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th
from safetensors.torch import load_file
from stable_baselines3.common.callbacks import BaseCallback
from tiny_runs import outcomes, read_config, write_settings

from saver_advisors.cli import main as saver
from saver_advisors.learner import GoalTD3
from saver_advisors.policies.teacher import Teacher
from saver_advisors.training.curve_file import OF_THE_MACHINE
from saver_advisors.training.launch import load_trained, train
from saver_advisors.training.run import RunResult
from saver_advisors.training.settings import AdviceConfig, RunConfig
from saver_envs.envs.sb3_vec_env import SaverVecEnv

BLOCK = 40  # 4 environments, 10 steps
CONFIG = RunConfig(
    "PointReach",
    n_envs=4,
    total_steps=6 * BLOCK,
    net_arch=(16,),
    batch_size=16,
    buffer_size=4 * BLOCK,
    gradient_steps=3,
    eval_every=BLOCK,
    eval_episodes=5,
    checkpoint_every=2 * BLOCK,
)
Start = Callable[..., RunResult]


class Crash(RuntimeError):
    """Stands for whatever kills a run."""


@pytest.fixture
def start(make_env: Any, monkeypatch: pytest.MonkeyPatch) -> Start:
    """A function (config, folder, ...) that trains on the point."""

    def evaluate(
        predict: Any,
        env_id: str,
        *,
        episodes: int,
        seed: int,
        env_kwargs: dict[str, Any],
        threads: int,
    ) -> Any:
        assert (env_id, seed) == ("PointReach", 10_000)
        env = make_env(episodes, **env_kwargs)
        env.seed(seed)
        observation = env.reset()
        # Evaluations are deterministic, SAC's too.
        np.testing.assert_array_equal(predict(observation), predict(observation))
        cost = np.zeros(episodes)
        for _ in range(10):
            observation, _, _, infos = env.step(predict(observation))
            cost += [info["cost"] for info in infos]
        success = np.array([info["is_success"] for info in infos])
        return outcomes(success, {"cost": cost, "cost_extra": 2 * cost})

    monkeypatch.setattr("saver_advisors.training.run.evaluate_policy", evaluate)
    monkeypatch.setattr(
        "saver_advisors.training.launch.build_env",
        lambda config, threads=1: make_env(config.n_envs, **config.env_kwargs),
    )
    return lambda config, folder, **arguments: train(
        config, folder, **({"progress": False} | arguments)
    )


def curve(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "curve.jsonl").read_text().splitlines()]


def timeless(lines: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{k: v for k, v in line.items() if k not in OF_THE_MACHINE} for line in lines]


def assert_same_checkpoint(one: Path, other: Path) -> None:
    """Every array, tensor, counter and generator, bit for bit."""
    with np.load(one / "replay.npz") as a, np.load(other / "replay.npz") as b:
        assert set(a) == set(b)
        for name in a:
            np.testing.assert_array_equal(a[name], b[name], err_msg=name)
    for file in ("policy.safetensors", "training.safetensors"):
        tensors, others = load_file(one / file), load_file(other / file)
        assert tensors.keys() == others.keys()
        for name, tensor in tensors.items():
            assert th.equal(tensor, others[name]), name
    states = [json.loads((folder / "state.json").read_text()) for folder in (one, other)]
    for state in states:
        # The times differ, and with them the checksums; so does the order of a header in a file.
        del (
            state["extra"]["wall_clock_s"],
            state["extra"]["processor_s"],
            state["files"],
            state["sha256"],
        )
    assert states[0] == states[1]


def test_a_run_leaves_curve_checkpoint_best_and_record(start: Start, tmp_path: Path) -> None:
    result = start(CONFIG, tmp_path)
    lines = curve(tmp_path)
    assert [line["steps"] for line in lines] == [BLOCK * (k + 1) for k in range(6)]
    assert [line["updates"] for line in lines] == [3 * (k + 1) for k in range(6)]
    assert all(line["cost"] == 5 and line["cost_extra"] == 10 for line in lines)
    assert all(line["advice_spent"] == 0 and line["critic_loss"] > 0 for line in lines)
    assert all(-50 < line["mean_q"] < 50 and line["wall_clock_s"] > 0 for line in lines)
    assert np.all(np.diff([line["wall_clock_s"] for line in lines]) > 0)
    rates = [line["success_rate"] for line in lines]
    best = json.loads((tmp_path / "best" / "evaluation.json").read_text())
    assert best == [line for line in lines if line["success_rate"] == max(rates)][-1]
    assert result == RunResult(tmp_path, True, 240, 18, result.wall_clock_s, rates[-1], max(rates))
    record = json.loads((tmp_path / "run.json").read_text())
    assert RunConfig.from_mapping(record["config"]) == CONFIG
    assert record["seed"] == 0
    assert record["world"] is None, "the toy is no registered id"
    assert record["sessions"][0].keys() >= {"command", "commit", "versions", "machine"}
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        ".lock",
        "best",
        "curve.jsonl",
        "latest",
        "run.json",
    ]


@pytest.mark.parametrize("algorithm", ["td3", "sac"])
@pytest.mark.parametrize("cut_short", [False, True])
def test_a_resumed_run_equals_an_uninterrupted_one(
    start: Start, tmp_path: Path, algorithm: str, cut_short: bool
) -> None:
    config = replace(
        CONFIG,
        algorithm=algorithm,
        env_kwargs={"cut_short": cut_short},
        final_learning_rate=1e-4,
    )
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    start(config, whole)
    first = start(config, parts, stop_after_steps=2 * BLOCK)
    assert (first.finished, first.steps, first.updates) == (False, 2 * BLOCK, 6)
    second = start(config, parts, resume=True, stop_after_steps=4 * BLOCK)
    assert (second.finished, second.steps, second.updates) == (False, 4 * BLOCK, 12)
    assert second.wall_clock_s > first.wall_clock_s
    third = start(config, parts, resume=True)
    assert (third.finished, third.steps, third.updates) == (True, 6 * BLOCK, 18)
    assert timeless(curve(whole)) == timeless(curve(parts))
    assert_same_checkpoint(whole / "latest", parts / "latest")
    sessions = json.loads((parts / "run.json").read_text())["sessions"]
    assert [session["from_steps"] for session in sessions] == [0, 2 * BLOCK, 4 * BLOCK]


def test_the_generators_of_sb3_go_on_too(start: Start, tmp_path: Path) -> None:
    """Its warm-up draws from the action space, its noise and other parts from NumPy's own."""

    class Draw(BaseCallback):
        def _on_step(self) -> bool:
            np.random.random()  # noqa: NPY002
            return True

    config = replace(CONFIG, learning_starts=3 * BLOCK + 1)
    start(config, tmp_path / "whole", callback=Draw())
    start(config, tmp_path / "parts", callback=Draw(), stop_after_steps=2 * BLOCK)
    start(config, tmp_path / "parts", callback=Draw(), resume=True)
    assert_same_checkpoint(tmp_path / "whole" / "latest", tmp_path / "parts" / "latest")


def test_lines_after_the_checkpoint_are_not_doubled(start: Start, tmp_path: Path) -> None:
    calls = 0

    class CrashInBlockFour(BaseCallback):
        def _on_step(self) -> bool:
            nonlocal calls
            calls += 1
            if calls == 35:
                raise Crash
            return True

    with pytest.raises(Crash):
        start(CONFIG, tmp_path / "parts", callback=CrashInBlockFour())
    assert [line["steps"] for line in curve(tmp_path / "parts")] == [BLOCK, 2 * BLOCK, 3 * BLOCK]
    with open(tmp_path / "parts" / "curve.jsonl", "a") as file:
        file.write('{"steps": 16')
    start(CONFIG, tmp_path / "parts", resume=True)
    start(CONFIG, tmp_path / "whole")
    assert timeless(curve(tmp_path / "parts")) == timeless(curve(tmp_path / "whole"))
    assert_same_checkpoint(tmp_path / "parts" / "latest", tmp_path / "whole" / "latest")


def test_a_finished_run_is_left_alone_or_prolonged(start: Start, tmp_path: Path) -> None:
    config = replace(CONFIG, total_steps=2 * BLOCK)
    first = start(config, tmp_path)
    again = start(config, tmp_path, resume=True)
    assert (again.finished, again.steps) == (True, 2 * BLOCK)
    assert again.success_rate == first.success_rate
    assert len(curve(tmp_path)) == 2
    longer = start(replace(config, total_steps=3 * BLOCK), tmp_path, resume=True)
    assert (longer.finished, longer.steps) == (True, 3 * BLOCK)
    assert [line["steps"] for line in curve(tmp_path)] == [BLOCK, 2 * BLOCK, 3 * BLOCK]


def test_another_run_is_not_overwritten(start: Start, tmp_path: Path) -> None:
    start(replace(CONFIG, total_steps=BLOCK), tmp_path)
    with pytest.raises(FileExistsError, match="resume=True"):
        start(CONFIG, tmp_path)
    with pytest.raises(ValueError, match=r"gamma: 0.98 -> 0.9\b"):
        start(replace(CONFIG, gamma=0.9), tmp_path, resume=True)


def test_resume_without_a_checkpoint_begins(start: Start, tmp_path: Path) -> None:
    result = start(replace(CONFIG, total_steps=BLOCK), tmp_path, resume=True)
    assert (result.finished, result.steps) == (True, BLOCK)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_block_and_leaves_a_checkpoint(
    start: Start, tmp_path: Path, number: signal.Signals
) -> None:
    class Signal(BaseCallback):
        def _on_step(self) -> bool:
            if self.num_timesteps == BLOCK + 12:
                os.kill(os.getpid(), number)
            return True

    handlers = [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)]
    result = start(replace(CONFIG, checkpoint_every=10**6), tmp_path, callback=Signal())
    assert (result.finished, result.steps, result.updates) == (False, 2 * BLOCK, 6)
    assert [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)] == handlers
    result = start(CONFIG, tmp_path, resume=True)
    assert (result.finished, result.steps) == (True, 6 * BLOCK)


def test_a_second_interrupt_ends_at_once(start: Start, tmp_path: Path) -> None:
    class Impatient(BaseCallback):
        def _on_step(self) -> bool:
            os.kill(os.getpid(), signal.SIGINT)
            return True

    with pytest.raises(KeyboardInterrupt):
        start(CONFIG, tmp_path, callback=Impatient())
    # The checkpoint with which a run begins is left: nothing was learned since.
    assert json.loads((tmp_path / "latest" / "state.json").read_text())["steps"] == 0
    assert start(CONFIG, tmp_path, resume=True).finished


def test_a_run_works_in_a_thread(start: Start, tmp_path: Path) -> None:
    results: list[RunResult] = []
    config = replace(CONFIG, total_steps=BLOCK)
    thread = threading.Thread(target=lambda: results.append(start(config, tmp_path)))
    thread.start()
    thread.join()
    assert results[0].finished


# Checkpoints -------------------------------------------------------------------------------------


@pytest.mark.parametrize("function", ["savez", "fsync"])
def test_a_full_disk_leaves_the_old_checkpoint(
    start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, function: str
) -> None:
    start(CONFIG, tmp_path, stop_after_steps=2 * BLOCK)
    shutil.copytree(tmp_path / "latest", tmp_path / "copy")
    shutil.rmtree(tmp_path / "best")

    def full_disk(*arguments: Any, **named: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    config = replace(CONFIG, eval_every=10**6)
    with monkeypatch.context() as patch:

        class FillDisk(BaseCallback):
            def _on_step(self) -> bool:
                patch.setattr(np if function == "savez" else os, function, full_disk)
                return True

        with pytest.raises(OSError, match=r"latest could not be written \(No space left") as caught:
            start(config, tmp_path, resume=True, callback=FillDisk())
        assert caught.value.errno == errno.ENOSPC
    assert_same_checkpoint(tmp_path / "latest", tmp_path / "copy")
    assert not list(tmp_path.glob(".latest*"))
    assert start(config, tmp_path, resume=True).finished


def test_a_crash_between_the_renames_is_survived(
    start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    start(CONFIG, tmp_path, stop_after_steps=2 * BLOCK)
    rename = os.replace

    def crash_before_the_second(source: Path, target: Path) -> None:
        if Path(source).name == ".latest.partial":
            raise Crash
        rename(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", crash_before_the_second)
        with pytest.raises(Crash):
            start(CONFIG, tmp_path, resume=True, stop_after_steps=4 * BLOCK)
    assert not (tmp_path / "latest").exists()
    result = start(CONFIG, tmp_path, resume=True)
    assert (result.finished, result.updates) == (True, 18)
    sessions = json.loads((tmp_path / "run.json").read_text())["sessions"]
    assert sessions[-1]["from_steps"] == 2 * BLOCK
    assert not list(tmp_path.glob(".latest*"))


@pytest.mark.parametrize(
    "name", ["policy.safetensors", "training.safetensors", "replay.npz", "state.json"]
)
def test_a_damaged_checkpoint_is_named(start: Start, tmp_path: Path, name: str) -> None:
    start(CONFIG, tmp_path, stop_after_steps=BLOCK)
    path = tmp_path / "latest" / name
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(ValueError, match=name.replace(".", r"\.")):
        start(CONFIG, tmp_path, resume=True)


def test_trained_policies_come_back(start: Start, tmp_path: Path, make_env: Any) -> None:
    start(CONFIG, tmp_path)
    models = [load_trained(tmp_path, which) for which in ("best", "latest")]
    observation = make_env(3).reset()
    for model, folder in zip(models, ("best", "latest"), strict=True):
        saved = load_file(tmp_path / folder / "policy.safetensors")
        for name, tensor in model.policy.state_dict().items():
            assert th.equal(tensor, saved[name])
        assert model.predict(observation)[0].shape == (3, 2)
    with pytest.raises(ValueError, match="which=first"):
        load_trained(tmp_path, "first")


# Advice ------------------------------------------------------------------------------------------


def test_the_budget_goes_on_after_a_resume(
    start: Start, tmp_path: Path, make_env: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    teacher = Teacher.from_sb3(
        GoalTD3(
            "MultiInputPolicy",
            make_env(1),
            buffer_size=100,
            policy_kwargs={"net_arch": [8]},
            seed=3,
        )
    )
    monkeypatch.setattr("saver_advisors.advising.advisor.load_teacher", lambda name: teacher)
    config = replace(CONFIG, advice=AdviceConfig("early", "point", budget=3 * BLOCK + 7))
    start(config, tmp_path / "whole")
    start(config, tmp_path / "parts", stop_after_steps=2 * BLOCK)
    state = json.loads((tmp_path / "parts" / "latest" / "state.json").read_text())
    assert state["extra"]["advisor"]["budget"]["spent"] == 2 * BLOCK
    start(config, tmp_path / "parts", resume=True)
    spent = [line["advice_spent"] for line in curve(tmp_path / "parts")]
    assert spent == [BLOCK, 2 * BLOCK, 3 * BLOCK, 127, 127, 127]
    assert timeless(curve(tmp_path / "whole")) == timeless(curve(tmp_path / "parts"))
    assert_same_checkpoint(tmp_path / "whole" / "latest", tmp_path / "parts" / "latest")
    with np.load(tmp_path / "whole" / "latest" / "replay.npz") as file:
        # The buffer keeps the last four blocks, of which 47 steps were advised.
        assert file["advised"].sum() == BLOCK + 7


# Configuration -----------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".yaml", ".yml", ".json"])
def test_configurations_survive_a_file(tmp_path: Path, suffix: str) -> None:
    config = replace(
        CONFIG,
        env_kwargs={"max_episode_steps": 7},
        learning_rate=3e-5,
        advice=AdviceConfig("mc-q", "jaco-push", 100, threshold=0.05),
    )
    path = tmp_path / f"run{suffix}"
    write_settings(config, path)
    assert read_config(path) == config


@pytest.mark.parametrize(
    ("values", "error", "message"),
    [
        ({"env_id": "a", "gama": 1}, ValueError, "unknown gama; valid names are env_id, env_kw"),
        ({"env_id": "a", "advice": {"budgett": 1}}, ValueError, "unknown advice.budgett; valid"),
        ({}, ValueError, "env_id must be given"),
        ({"env_id": "a", "advice": {"strategy": "early"}}, ValueError, "advice.teacher, advice.b"),
        ({"env_id": "a", "learning_rate": "1e-3"}, TypeError, "write 1.0e-3"),
        ({"env_id": "a", "n_envs": 2.0}, TypeError, "n_envs=2.0 must be a whole number"),
        ({"env_id": "a", "n_envs": True}, TypeError, "n_envs=True must be a whole number"),
        ({"env_id": "a", "n_envs": 0}, ValueError, "n_envs=0 must be positive"),
        ({"env_id": "a", "final_learning_rate": 0.1}, ValueError, "at most learning_rate=0.001"),
        ({"env_id": "a", "final_learning_rate": 0.0}, ValueError, "final_learning_rate=0.0 must"),
        ({"env_id": "a", "gamma": 1}, ValueError, "gamma=1 must be in"),
        ({"env_id": "a", "target_policy_noise": -0.1}, ValueError, "target_policy_noise=-0.1 must"),
        ({"env_id": "a", "target_noise_clip": -0.1}, ValueError, "target_noise_clip=-0.1 must"),
        ({"env_id": "a", "imitation_weight": -1.0}, ValueError, "imitation_weight=-1.0 must be 0"),
        ({"env_id": "a", "algorithm": "ppo"}, ValueError, "algorithm='ppo' must be one of"),
        ({"env_id": "a", "net_arch": []}, ValueError, "net_arch="),
        ({"env_id": "a", "net_arch": [64, "x"]}, TypeError, "net_arch="),
    ],
)
def test_wrong_configurations_are_named(
    values: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        RunConfig.from_mapping(values)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
@pytest.mark.parametrize(
    "name", [one.name for one in fields(RunConfig) if "float" in str(one.type).lower()]
)
def test_no_setting_is_infinite_or_no_number(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=rf"{name}={value} must be finite"):
        RunConfig.from_mapping({"env_id": "a", name: value})


def test_the_learning_rate_falls_through_the_last_third(start: Start, tmp_path: Path) -> None:
    config = replace(CONFIG, learning_rate=1e-3, final_learning_rate=1e-4)
    rates = [config.learning_rate_at(steps * BLOCK) for steps in range(8)]
    expected = [1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 5.5e-4, 1e-4, 1e-4]
    np.testing.assert_allclose(rates, expected, rtol=1e-12)
    assert CONFIG.learning_rate_at(6 * BLOCK) == CONFIG.learning_rate

    seen: list[float] = []

    class Watch(BaseCallback):
        def _on_rollout_start(self) -> None:
            # What the gradient steps of the block before were done with.
            optimizers = (self.model.policy.actor.optimizer, self.model.policy.critic.optimizer)
            seen.extend({group["lr"] for one in optimizers for group in one.param_groups})

        def _on_step(self) -> bool:
            return True

    start(config, tmp_path, callback=Watch())
    np.testing.assert_allclose(seen, [1e-3, *expected[:5]], rtol=1e-12)


@pytest.mark.parametrize(
    ("name", "text"), [("a.yaml", "env_id: [1"), ("a.yaml", "3"), ("a.json", "{"), ("a.txt", "")]
)
def test_unreadable_configurations_are_named(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(ValueError, match=name.replace(".", r"\.")):
        read_config(tmp_path / name)


def test_every_field_is_documented() -> None:
    for cls in (RunConfig, AdviceConfig):
        for field in dataclasses.fields(cls):
            assert f":param {field.name}:" in (cls.__doc__ or "")


def test_threads_are_torchs_for_the_time_of_the_run(start: Start, tmp_path: Path) -> None:
    seen: list[int] = []

    class Look(BaseCallback):
        def _on_step(self) -> bool:
            seen.append(th.get_num_threads())
            return True

    before = th.get_num_threads()
    start(CONFIG, tmp_path / "two", threads=2, callback=Look())
    assert set(seen) == {2}
    assert th.get_num_threads() == before
    with pytest.raises(ValueError, match="threads=0"):
        start(CONFIG, tmp_path / "none", threads=0)
    assert not (tmp_path / "none").exists()


# Command -----------------------------------------------------------------------------------------


def test_the_command_builds_one_environment_and_one_learner(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Evaluations have environments of their own, of another number."""
    built: list[str] = []

    def counted(kind: type[Any]) -> None:
        init = kind.__init__

        def count(self: Any, *arguments: Any, **named: Any) -> None:
            if named.get("n_envs") != 3:
                built.append(kind.__name__)
            init(self, *arguments, **named)

        monkeypatch.setattr(kind, "__init__", count)

    counted(SaverVecEnv)
    counted(GoalTD3)
    words = ["train", "--env", "DualJacoPush-v0", "--output", str(tmp_path / "run")]
    words += ["--steps", "20", "--no-progress", "--env-kwargs", "max_episode_steps=10", "--set"]
    words += ["n_envs=2", "batch_size=16", "gradient_steps=1", "buffer_size=200", "eval_episodes=3"]
    assert saver(words) == 0
    assert sorted(built) == ["GoalTD3", "SaverVecEnv"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["env_kwargs.horizon=-1"], "error: env_kwargs: "),
        (["train_env_kwargs.horizon=-1"], "error: train_env_kwargs: "),
        (["train_env_kwargs.horizen=10"], "error: train_env_kwargs: "),
        (
            ["advice={strategy: early, teacher: jaco-pick-and-place, budget: 1000}"],
            "error: advice: teacher 'jaco-pick-and-place' has actions of size 4",
        ),
        (["stages=[{stage: exploring}]"], "error: "),
        (["constraint_relabelling=keep"], "error: "),
    ],
)
def test_wrong_settings_are_reported_before_a_file_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    folder = tmp_path / "run"
    more = ["--no-progress", "--set", "n_envs=2", "buffer_size=200", *words]
    assert saver(["train", "--env", "DualJacoPush-v0", "--output", str(folder), *more]) == 2
    text = capsys.readouterr().err
    assert text.count("\n") == 1
    assert message in text
    assert not folder.exists()
