"""`saver benchmark run` and `compare`: a stranger's algorithm, held to the rules."""

from __future__ import annotations

import argparse
import json
import re
import shlex
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium import make_vec
from run_files import curve, write_run

from saver_advisors.cli import SAVER, main
from saver_advisors.cli.benchmark_run import plan_of as plan_from
from saver_advisors.cli.benchmark_run import seed_range
from saver_advisors.evaluation.metrics import EPOCH_STEPS
from saver_advisors.evaluation.protocol import (
    EVALUATE_EVERY,
    REPORT_EPISODES,
    REPORT_SEED,
    SEED_STRIDE,
    SELECTION_EPISODES,
    SELECTION_SEED,
    TRAINING_SEED,
    off_protocol,
    training_seed,
)
from saver_advisors.experiments.recorder import BenchmarkPlan, Recorder
from saver_advisors.experiments.results import changed_settings
from saver_advisors.experiments.third_party import (
    BudgetSpent,
    CountedVectorEnv,
    load_object,
    resolved,
)
from saver_advisors.experiments.training_runs import read_training_runs
from saver_advisors.training.defaults import default_settings
from saver_envs.digest import world_digest
from saver_envs.envs.sb3_vec_env import SaverVecEnv
from saver_envs.registration import varied_in

ROOT = Path(__file__).resolve().parents[2]
HERE = Path(__file__).with_name("algorithms.py")
EXAMPLE = ROOT / "docs" / "examples" / "td3_her.py"


def words(output: Path, algorithm: str, *more: object) -> list[str]:
    """A run of 80 steps: 2 environments, episodes of 10."""
    tiny = "--steps 80 --seed 3 --n-envs 2 --eval-every 40 --eval-episodes 2 --report-episodes 3"
    start = ["benchmark", "run", "--env", "JacoPush-v0", "--algo", algorithm]
    end = ["--output", str(output), "--env-kwargs", "max_episode_steps=10"]
    return [*start, *tiny.split(), *end, *map(str, more)]


def record(folder: Path) -> dict[str, Any]:
    """The only result file of a folder."""
    [path] = folder.glob("*.json")
    content: dict[str, Any] = json.loads(path.read_text())
    return content


def test_training_choice_and_report_never_meet() -> None:
    # A run in 1,000 environments takes seeds up to 999 beyond its first.
    taken = {training_seed(seed) + offset for seed in range(3) for offset in (0, 999)}
    assert len(taken) == 6
    assert min(taken) == TRAINING_SEED
    report = range(REPORT_SEED, REPORT_SEED + REPORT_EPISODES)
    selection = range(SELECTION_SEED, SELECTION_SEED + SELECTION_EPISODES)
    assert not set(report) & set(selection)
    assert max(*report, *selection) < TRAINING_SEED
    assert training_seed(10**6) < 2**31
    for wrong in (-1, 10**7):
        with pytest.raises(ValueError, match=f"seed={wrong}"):
            training_seed(wrong)


def test_a_plain_algorithm_is_trained_and_recorded(tmp_path: Path) -> None:
    assert main(words(tmp_path, f"{HERE}:Drifter", "--algo-kwargs", "speed=0.25")) == 0
    content = record(tmp_path)
    assert content["kind"] == "training-run"
    assert (content["task"], content["row"], content["seed"]) == ("JacoPush-v0", "Drifter", 3)
    assert content["finished"]
    assert [line["steps"] for line in content["curve"]] == [40, 80]
    assert content["curve"][0].keys() >= {"success_rate", "wall_clock_s", "cost_collision"}
    rates = {"safe_success_rate", "success_rate_2cm", "collision_force_mean"}
    assert content["curve"][0].keys() & content["final"].keys() >= rates
    assert content["world"] == content["final"]["world"]
    assert len(content["world"]) == 16
    assert content["config"]["algo_kwargs"] == {"speed": 0.25}
    assert len(content["config"]["source_sha256"]) == 64
    assert content["config"]["eval_seed"] == 10_000
    # No weights to go back to: the last policy is reported, on the report seeds.
    assert content["chosen"] is None
    assert (content["final"]["seed"], content["final"]["episodes"]) == (0, 3)
    assert content["provenance"].keys() >= {"command", "versions"}
    [run] = read_training_runs([tmp_path]).runs
    assert run.final_success == content["final"]["success_rate"]


def test_training_starts_are_from_training_seeds(tmp_path: Path) -> None:
    module = load_object(f"{HERE}:Drifter")
    plan = plan_of(total_steps=10)
    env = make_vec("saver_envs:JacoPush-v0", 2, vectorization_mode="vector_entry_point")
    counted = CountedVectorEnv(env, Recorder(plan, tmp_path))
    learner = module(counted, seed=plan.seed)
    learner.env.reset()
    first, _ = counted.reset(seed=plan.seed)
    again, _ = counted.reset(seed=[3, 4])
    same, _ = env.reset(seed=[training_seed(3), training_seed(4)])
    np.testing.assert_array_equal(again["observation"], same["observation"])
    np.testing.assert_array_equal(first["observation"][0], same["observation"][0])
    report, _ = env.reset(seed=3)
    assert not np.allclose(report["observation"][0], same["observation"][0])


def plan_of(**changes: Any) -> BenchmarkPlan:
    """A plan of a tiny run."""
    values: dict[str, Any] = {
        "name": "run",
        "row": "row",
        "env_id": "JacoPush-v0",
        "env_kwargs": {"max_episode_steps": 10},
        "algorithm": "x:Y",
        "algo_kwargs": {},
        "source_sha256": None,
        "n_envs": 2,
        "total_steps": 100,
        "seed": 3,
        "eval_every": 50,
        "eval_episodes": 1,
        "report_episodes": 1,
    }
    return BenchmarkPlan(**{**values, **changes})


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_steps_that_only_reset_are_not_counted(tmp_path: Path, mode: str) -> None:
    recorder = Recorder(plan_of(total_steps=45, eval_every=10**6), tmp_path)
    env = make_vec(
        "saver_envs:JacoPush-v0",
        2,
        vectorization_mode="vector_entry_point",
        max_episode_steps=10,
        autoreset_mode=mode,
    )
    counted = CountedVectorEnv(env, recorder)
    recorder.begin(lambda observation: np.zeros((len(observation["observation"]), 3)), None)
    counted.reset()
    stepped = 0
    with pytest.raises(BudgetSpent, match="45"):
        while True:
            counted.step(np.zeros((2, 3)))
            stepped += 1
    # 46 is the first even number with the budget; every 11th step of NextStep resets both.
    assert recorder.steps == 46
    assert stepped == (23 + 2 if mode == "NextStep" else 23)
    assert [line["steps"] for line in recorder.curve] == [46]


def test_the_cost_of_training_is_summed_whatever_the_reset(tmp_path: Path) -> None:
    """Cubes that are in the hands at the start are mostly not as far apart as required."""
    options = {"in_hand_probability": 1.0, "max_episode_steps": 5}
    plan = plan_of(env_id="DualJacoDistance-v0", env_kwargs=options, eval_every=10**6)
    batch = SaverVecEnv(plan.env_id, 2, training_seed(plan.seed), **options)
    batch.reset()
    steps = [batch.step(np.zeros((2, 8))) for _ in range(10)]
    expected = sum(info["cost"] for _, _, _, infos in steps for info in infos)
    assert expected > 5
    for mode in ("NextStep", "SameStep"):
        recorder = Recorder(plan, tmp_path)
        env = make_vec(
            f"saver_envs:{plan.env_id}",
            2,
            vectorization_mode="vector_entry_point",
            autoreset_mode=mode,
            **options,
        )
        counted = CountedVectorEnv(env, recorder)
        counted.reset()
        while recorder.steps < 20:
            counted.step(np.zeros((2, 8)))
        assert recorder.training_cost == expected, mode


def test_worlds_vary_in_training_and_in_evaluations(tmp_path: Path) -> None:
    """With episodes of one length: slow arms need longer ones than Gymnasium has registered."""
    usual = words(tmp_path, f"{HERE}:Drifter")[:-2]  # the length
    assert main([*usual, "--randomization", "wide"]) == 0
    trained = load_last("Drifter").made[-1].env.unwrapped.episodes.settings
    assert trained.horizon == 125
    varied = trained.randomization.as_json()
    assert varied == varied_in("JacoPush-v0", {"randomization": "wide"})
    written = record(tmp_path)
    assert written["config"]["env_kwargs"] == {"randomization": "wide"}
    assert written["final"]["randomization"] == varied


def test_options_for_training_alone_are_recorded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    more = ("--train-env-kwargs", "object_mass=0.3")
    assert main(words(tmp_path, f"{HERE}:Drifter", *more)) == 0
    assert load_last("Drifter").made[-1].env.unwrapped.episodes.task.object_mass == 0.3
    content = record(tmp_path)
    assert content["config"]["train_env_kwargs"] == {"object_mass": 0.3}
    assert content["world"] == world_digest("JacoPush-v0", {"max_episode_steps": 10})
    assert main(words(tmp_path, f"{HERE}:Drifter", "--train-env-kwargs", "object_mas=1")) == 2
    assert "argument --train-env-kwargs" in capsys.readouterr().err


def test_results_without_options_for_training_are_still_finished(tmp_path: Path) -> None:
    """Files of earlier versions do not have the entry."""
    given = plan_of().config()
    del given["train_env_kwargs"]
    assert not changed_settings(plan_of(), given)
    easier = plan_of(train_env_kwargs={"in_hand_probability": 0.4})
    assert changed_settings(easier, given) == ["train_env_kwargs"]


def test_greed_for_steps_ends_with_the_budget(tmp_path: Path) -> None:
    assert main(words(tmp_path, f"{HERE}:Drifter", "--algo-kwargs", "greedy=true")) == 0
    assert record(tmp_path)["curve"][-1]["steps"] == 80


def test_being_evaluated_leaves_no_trace(tmp_path: Path) -> None:
    noises = []
    for every in (10, 80):
        np.random.seed(0)  # noqa: NPY002  (the generator that strangers use)
        output = tmp_path / str(every)
        assert main(words(output, f"{HERE}:Drifter", "--eval-every", every)) == 0
        noises.append(load_last("Drifter").made[-1].noise)
        assert len(record(output)["curve"]) == 80 // every
    assert noises[0] == noises[1]


def load_last(name: str) -> Any:
    """A class of the module as the command loaded it last."""
    import sys

    return getattr(sys.modules["algorithms"], name)


def test_the_best_checkpoint_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rates = iter([1.0, 0.5, 0.5, 0.0, 0.25, 0.75])  # four evaluations, then the last, then the best

    class Outcomes:
        def summary(self) -> dict[str, Any]:
            rate = next(rates)
            return {
                "success_rate": rate,
                "safe_success_rate": rate,
                "success_rate_2cm": rate,
                "ci95": [0, 1],
                "env": "x",
                "episodes": 3,
                "seed": 0,
                "cost_means": {},
                "final_distance_mean": [0.1],
                "diverged": 0,
            }

    monkeypatch.setattr(
        "saver_advisors.experiments.recorder.evaluate_policy", lambda *_, **__: Outcomes()
    )
    assert main(words(tmp_path, f"{HERE}:Counter", "--eval-every", 20)) == 0
    content = record(tmp_path)
    assert [line["success_rate"] for line in content["curve"]] == [1.0, 0.5, 0.5, 0.0]
    assert (content["chosen"]["steps"], content["chosen"]["success_rate"]) == (20, 0.75)
    assert content["final"]["success_rate"] == 0.25
    # What it had counted when that checkpoint was taken: the step in progress not yet.
    assert load_last("Counter").last.steps.item() == 18


def test_no_checkpoint_is_reported_without_weights(tmp_path: Path) -> None:
    assert main(words(tmp_path, f"{HERE}:Elsewhere")) == 0
    assert record(tmp_path)["chosen"] is None
    assert not list(tmp_path.glob("*.safetensors"))


def test_an_interrupted_run_leaves_its_curve_and_is_redone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from saver_advisors.experiments import recorder as module

    def interrupt(self: Recorder, steps: int, cost: float) -> None:
        advance(self, steps)
        if self.curve:
            raise KeyboardInterrupt

    advance = Recorder.advance
    monkeypatch.setattr(module.Recorder, "advance", interrupt)
    assert main(words(tmp_path, f"{HERE}:Drifter")) == 130
    assert not record(tmp_path)["finished"]
    assert [line["steps"] for line in record(tmp_path)["curve"]] == [40]
    monkeypatch.setattr(module.Recorder, "advance", advance)
    assert main(words(tmp_path, f"{HERE}:Drifter")) == 0
    assert "starts again" in capsys.readouterr().out
    assert record(tmp_path)["finished"]
    [path] = tmp_path.glob("*.json")
    before = path.read_bytes()
    assert main(words(tmp_path, f"{HERE}:Drifter")) == 0
    assert "already finished" in capsys.readouterr().out
    assert path.read_bytes() == before
    assert main(words(tmp_path, f"{HERE}:Drifter", "--n-envs", 4)) == 2
    assert "n_envs" in capsys.readouterr().err
    path.write_bytes(before[:200])
    assert main(words(tmp_path, f"{HERE}:Drifter")) == 0
    assert record(tmp_path)["finished"]


def test_a_class_of_sb3(tmp_path: Path) -> None:
    small = [
        "learning_starts=30",
        "buffer_size=200",
        "batch_size=8",
        "noise_std=0.1",
        "train_freq=10",
    ]
    named = "replay_buffer_class=import:stable_baselines3:HerReplayBuffer"
    kwargs = ["--algo-kwargs", "policy_kwargs={net_arch: [8]}", named, *small]
    told = ["--name", "ddpg-her", "--teacher-steps", 7]
    assert main(words(tmp_path, "stable_baselines3:DDPG", *kwargs, *told)) == 0
    content = record(tmp_path)
    assert (content["row"], content["teacher_steps"]) == ("ddpg-her", 7)
    assert [line["steps"] for line in content["curve"]] == [40, 80]
    assert content["curve"][-1]["training_cost"] >= content["curve"][0]["training_cost"] >= 0
    assert content["chosen"]["steps"] in (40, 80)
    [weights] = tmp_path.glob("*.safetensors")
    assert weights.stem == "JacoPush-v0-ddpg-her-seed3"


@pytest.mark.parametrize(
    ("algorithm", "more", "named"),
    [
        ("td3_her", (), "MODULE:CLASS"),
        ("no.such.module:TD3", (), "no.such.module"),
        ("nowhere.py:TD3", (), "nowhere.py"),
        (f"{HERE}:Drift", (), "Drifter"),
        (f"{HERE}:np", (), "cannot be called"),
        (f"{HERE}:Mute", (), "no method 'predict'"),
        (f"{HERE}:Drifter", ("--algo-kwargs", "speed=-1"), "speed=-1"),
        (f"{HERE}:Drifter", ("--algo-kwargs", "sped=1"), "sped"),
        (f"{HERE}:Drifter", ("--algo-kwargs", "speed=import:math:tau2"), "tau2"),
        ("stable_baselines3:DQN", (), "DQN cannot be built"),
        (f"{HERE}:Drifter", ("--seed", "9999999"), "--seed"),
    ],
)
def test_mistakes_are_told_before_the_run(
    tmp_path: Path,
    algorithm: str,
    more: tuple[str, ...],
    named: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(words(tmp_path, algorithm, *more)) == 2
    assert named in capsys.readouterr().err
    assert not list(tmp_path.glob("*.json"))


def test_named_arguments_are_imported() -> None:
    assert resolved({"a": "import:math:tau", "b": "plain", "c": 1})["a"] == pytest.approx(6.2831853)


def test_the_example_learner(tmp_path: Path) -> None:
    kwargs = ["hidden=[8]", "batch_size=16", "updates=2", "capacity=8"]
    assert main(words(tmp_path, f"{EXAMPLE}:TD3HER", "--algo-kwargs", *kwargs)) == 0
    content = record(tmp_path)
    assert [line["steps"] for line in content["curve"]] == [40, 80]
    assert content["row"] == "TD3HER"


def test_the_example_relabels_with_what_its_episode_reached_later() -> None:
    episodes = load_object(f"{EXAMPLE}:Episodes")(4, 5, (1, 1, 1), 0)
    place = np.arange(6.0, dtype=np.float32)[None, :, None]
    episodes.add(place, 100 + place, np.array([[-1.0]]), place[:, :5], np.array([5]))
    given: list[tuple[np.ndarray, np.ndarray]] = []

    def reward(achieved: np.ndarray, goal: np.ndarray, info: dict[str, Any]) -> np.ndarray:
        given.append((achieved, goal))
        return -(np.abs(achieved - goal)[:, 0] > 0.5).astype(float)

    now, action, rewards, then = (one.numpy() for one in episodes.draw(500, 0.8, reward))
    step, goal = now[:, 0], now[:, 1]
    np.testing.assert_array_equal(action[:, 0], step)
    np.testing.assert_array_equal(then[:, 0], step + 1)
    np.testing.assert_array_equal(then[:, 1], goal)
    own = goal == -1
    assert 0.1 < own.mean() < 0.3
    assert (goal[~own] - 100 >= step[~own] + 1).all()
    np.testing.assert_array_equal(given[0][0][:, 0], 100 + step + 1)
    np.testing.assert_array_equal(rewards == 0, goal == 101 + step)


@pytest.mark.slow
def test_several_seeds_in_processes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    several = words(tmp_path, f"{HERE}:Drifter")
    several[several.index("--seed") : several.index("--seed") + 2] = ["--seeds", "3-4"]
    assert main(words(tmp_path, f"{HERE}:Drifter")) == 0
    kept = record(tmp_path)
    assert main([*several, "--processes", "2"]) == 0
    out = capsys.readouterr().out
    assert "JacoPush-v0-Drifter-seed3.json is already finished" in out
    assert "JacoPush-v0-Drifter-seed4  done" in out
    by_seed = {one.seed: one for one in read_training_runs([tmp_path]).runs}
    assert sorted(by_seed) == [3, 4]
    assert by_seed[3].provenance == kept["provenance"], "a finished seed is kept"
    assert all(one.finished and one.final_success is not None for one in by_seed.values())
    # One more seed of the same settings, and none of others.
    assert main([*several, "--n-envs", "4"]) == 2
    assert "n_envs" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "seeds"),
    [("0-4", [0, 1, 2, 3, 4]), ("7", [7]), ("3,0,3", [0, 3]), ("0-1,5-6", [0, 1, 5, 6])],
)
def test_ranges_of_seeds(text: str, seeds: list[int]) -> None:
    assert seed_range(text) == seeds


@pytest.mark.parametrize("text", ["", "4-2", "a", "0-", "-1", "0..4"])
def test_ranges_that_are_none(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match=r"must be such as|holds no seed"):
        seed_range(text)


RULES = {"eval_every": EVALUATE_EVERY, "eval_episodes": SELECTION_EPISODES}
REPORT = {"episodes": REPORT_EPISODES, "seed": REPORT_SEED, "success_rate": 1.0}


@pytest.mark.parametrize(
    ("config", "final", "told"),
    [
        ({}, REPORT, []),
        ({**RULES, "eval_seed": SELECTION_SEED}, REPORT, []),
        ({"eval_every": 10}, REPORT, ["eval_every 10 not 25000"]),
        ({"eval_episodes": 5, "eval_seed": 0}, REPORT, ["eval_episodes 5", "eval_seed 0"]),
        ({}, {**REPORT, "episodes": 50, "seed": 9}, ["final episodes 50", "final seed 9"]),
        ({}, None, ["no final episodes"]),
    ],
)
def test_deviations_from_the_protocol_are_listed(
    config: dict[str, Any], final: dict[str, Any] | None, told: list[str]
) -> None:
    found = off_protocol(config, final)
    assert len(found) == len(told)
    assert all(one.startswith(start) for one, start in zip(found, told, strict=True))


def test_runs_off_protocol_are_marked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")  # wide enough for a cell in one line
    ours, yours = tmp_path / "ours", tmp_path / "yours"
    for folder in (ours, yours):
        folder.mkdir()
    final = {"success_rate": 0.9, "ci95": [0.8, 1.0], "episodes": 500, "seed": 0}
    for seed in range(5):
        write_run(ours, "JacoPush-v0", "by the rules", seed, curve(8), final=final)
    write_run(yours, "JacoPush-v0", "short", 0, curve(8), final={**final, "episodes": 20})
    write_run(yours, "JacoPush-v0", "early", 0, curve(8), final=None)
    page, data = tmp_path / "page.md", tmp_path / "all.json"
    words = ["benchmark", "compare", str(yours), "--baselines", str(ours), "--table", str(page)]
    assert main([*words, "--json", str(data)]) == 0
    text = page.read_text()
    assert "| short | 1 of 5 seeds; final episodes 20 not 500 |" in text
    assert "| early | 1 of 5 seeds; no final episodes |" in text
    assert "| by the rules | " not in text.split("not measured by the protocol")[1].split("\n\n")[1]
    assert "1 of 5 seeds" in capsys.readouterr().out
    marked = {one["row"]: one["off_protocol"] for one in json.loads(data.read_text())["detail"]}
    assert marked["by the rules"] == ""


def test_a_result_says_that_it_is_off_protocol(tmp_path: Path) -> None:
    assert main(words(tmp_path, f"{HERE}:Drifter")) == 0
    assert record(tmp_path)["off_protocol"] == [
        "eval_every 40 not 25000",
        "eval_episodes 2 not 100",
        "final episodes 3 not 500",
    ]


def test_a_file_of_the_current_folder_hides_no_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "colorsys.py").write_text("hls_to_rgb = None")
    (tmp_path / "own_algorithms_here.py").write_text("Mine = dict")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", [*sys.path])
    monkeypatch.delitem(sys.modules, "colorsys", raising=False)
    assert load_object("own_algorithms_here:Mine") is dict
    assert callable(load_object("colorsys:hls_to_rgb"))


def test_comparing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    yours, ours = tmp_path / "yours", tmp_path / "ours"
    yours.mkdir()
    ours.mkdir()
    for seed in range(2):
        write_run(yours, "JacoPush-v0", "td3", seed, curve(8 + seed, evaluations=20))
        write_run(ours, "JacoPush-v0", "none", seed, curve(16 + seed))
    write_run(yours, "JacoPush-v0", "none", 0, curve(12))
    write_run(ours, "DualJacoPush-v0", "none", 0, curve(12))
    (yours / "cut.json").write_text("{")
    page, figure, data = tmp_path / "page.md", tmp_path / "figure.png", tmp_path / "all.json"
    words = ["benchmark", "compare", yours, "--baselines", ours, "--table", page]
    assert main([*map(str, [*words, "--figure", figure, "--json", data])]) == 0
    assert "left out cut.json" in capsys.readouterr().out
    text = page.read_text()
    assert "DualJacoPush" not in text
    assert text.index("| none (yours) | 1 |") < text.index("| none | 2 |")
    assert "| td3 | none | 2 and 2 | 1.52 [1.44, 1.60] |" in text
    assert "![learning curves](figure.png)" in text
    assert figure.stat().st_size > 10_000
    content = json.loads(data.read_text())
    better = {one["row"]: one for one in content["improvement"]}
    assert better["td3"]["value"] == 1.0
    assert better["td3"]["ci95"] == [1.0, 1.0]
    assert better["none (yours)"]["ci95"] is None
    # Over the steps of the shortest run.
    detail = {one["row"]: one for one in content["detail"]}
    assert detail["none"]["area"]["value"] < 0.5


def test_results_of_different_worlds_are_not_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    yours, ours = tmp_path / "yours", tmp_path / "ours"
    yours.mkdir()
    ours.mkdir()
    for number, (folder, kwargs) in enumerate(((yours, {"object_mass": 0.4}), (ours, {}))):
        config = {"env_id": "JacoPush-v0", "env_kwargs": kwargs}
        world = world_digest("JacoPush-v0", kwargs)
        row = f"row{number}"
        write_run(folder, "JacoPush-v0", row, 0, curve(8), config=config, world=world)
    words = ["benchmark", "compare", str(yours), "--baselines", str(ours)]
    assert main(words) == 2
    told = capsys.readouterr().err
    assert "JacoPush-v0-row0-0.json and JacoPush-v0-row1-0.json" in told
    assert "object_mass is 0.4 and the default" in told
    write_run(ours, "JacoPush-v0", "row1", 0, curve(8))  # as an older version wrote it
    page = tmp_path / "page.md"
    assert main([*words, "--table", str(page)]) == 0
    assert "without a digest" in capsys.readouterr().out
    assert "`JacoPush-v0-row1-0.json`" in page.read_text()
    world = world_digest("JacoPush-v0", {"object_mass": 0.4})
    config = {"env_id": "JacoPush-v0", "env_kwargs": {"object_mass": 0.4}}
    write_run(ours, "JacoPush-v0", "row1", 0, curve(8), config=config, world=world)
    assert main(words) == 0
    assert "without a digest" not in capsys.readouterr().out


def test_comparing_what_is_not_finished(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_run(tmp_path, "JacoPush-v0", "td3", 0, curve(8), finished=False)
    assert main(["benchmark", "compare", str(path), "--baselines", str(path)]) == 2
    assert "none of the runs is finished" in capsys.readouterr().err


def test_the_page_says_what_the_code_does() -> None:
    text = (ROOT / "docs" / "benchmark-protocol.md").read_text()
    for told in (
        f"from {TRAINING_SEED:,} + {SEED_STRIDE:,} x",
        f"{SELECTION_SEED:,} to {SELECTION_SEED + SELECTION_EPISODES - 1:,}",
        f"{SELECTION_EPISODES} episodes every {EVALUATE_EVERY:,} steps",
        f"{REPORT_SEED} to {REPORT_SEED + REPORT_EPISODES - 1}",
        f"{REPORT_EPISODES} episodes of the last policy",
        f"of {EPOCH_STEPS:,} environment steps",
    ):
        assert told in text, told


def test_the_pages_commands_can_be_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    text = (ROOT / "docs" / "benchmark-protocol.md").read_text()
    blocks = re.findall(r"^```bash\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)
    commands = [line for block in blocks for line in block.replace("\\\n", "").splitlines()]
    assert len(commands) == 5
    for command in commands:
        program, *rest = shlex.split(command)
        assert program == "saver"
        SAVER.parser(rest[0]).parse_args(rest)


def test_the_budget_is_the_environments_own(tmp_path: Path) -> None:
    given = ["benchmark", "run", "--env", "JacoPush-v0", "--algo", f"{HERE}:Drifter"]
    args = SAVER.parser("benchmark").parse_args([*given, "--seed", "0", "--output", str(tmp_path)])
    own = default_settings("JacoPush-v0")["total_steps"]
    assert plan_from(args, load_object(f"{HERE}:Drifter"), 0).total_steps == own
