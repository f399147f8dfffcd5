"""Runs under RL Zoo: what is executed is what is stored, and what is saved goes on."""

from __future__ import annotations

import re
import sys
from collections import deque
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import rl_zoo3.train
import yaml
from rl_zoo3 import ALGOS
from stable_baselines3 import SAC, TD3
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv
from zoo_runs import CONFIGS, STARTING, TINY, tiny

from saver_advisors.advising import AdvisedMixin
from saver_advisors.cli import main
from saver_advisors.zoo import manager
from saver_advisors.zoo.__main__ import main as zoo_program
from saver_advisors.zoo.manager import SuccessEvalCallback
from saver_advisors.zoo.vec_env import BatchedVecEnv
from saver_envs.envs.sb3_vec_env import SaverVecEnv
from saver_envs.registration import varied_in

STOCK = ("ddpg", "td3", "sac", "tqc")
DUAL = "DualJacoPush-v0"
DISTANCE = "DualJacoDistance-v0"
"""Its student starts as two teachers, by `goal_td3.yml`."""
SOME = ("--advice", "mc-act", "--teacher", "jaco-push", "--threshold", "1.2", "--budget", "120")
"""Advice to some of the arms at some of the steps."""


def record(monkeypatch: pytest.MonkeyPatch, vec_env: type[Any]) -> list[Any]:
    """What a vector env is told to do, step by step: for workers too, it is what they are sent."""
    told: list[Any] = []
    step_async = vec_env.step_async

    def keep(self: Any, actions: Any) -> None:
        told.append(np.array(actions))
        step_async(self, actions)

    monkeypatch.setattr(vec_env, "step_async", keep)
    return told


def check_advised_blocks(model: Any, told: Any, rows: dict[str, Any]) -> None:
    """As many environment steps have a teacher's block as the advisor has counted."""
    advisor = model.advisor
    flat = {key: values.reshape(-1, values.shape[-1]) for key, values in rows.items()}
    teacher = advisor.teachers.act(
        advisor.mapping.split_observation(flat["observation"]),
        advisor.mapping.split_goal(flat["desired_goal"]),
    )
    executed = advisor.mapping.split_action(told.reshape(-1, told.shape[-1]))
    advised = (np.abs(teacher - executed) < 1e-5).all(axis=-1)
    assert 0 < advisor.spent < len(executed)
    assert int(advised.any(axis=1).sum()) == advisor.spent
    np.testing.assert_array_equal(advised.sum(axis=0), advisor.advised_per_arm)


@pytest.mark.parametrize("vec_env", ["batched", "dummy"])
@pytest.mark.parametrize("algorithm", STOCK)
def test_executed_is_stored(
    algorithm: str,
    vec_env: str,
    models: list[Any],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    """Through warm-up, noise (DDPG, TD3: the file's; SAC, TQC: their own), advice and HER."""
    told = record(monkeypatch, SaverVecEnv if vec_env == "batched" else DummyVecEnv)
    more = () if vec_env == "batched" else ("--", "--vec-env", "dummy")
    assert main(tiny(algorithm, DUAL, tmp_path, *SOME, *more)) == 0
    (model,) = models
    assert isinstance(model, AdvisedMixin)
    assert type(model) is ALGOS[f"advised_{algorithm}"]
    if algorithm in ("ddpg", "td3"):
        assert model.action_noise is not None
    assert model._n_updates > 0
    buffer, executed = model.replay_buffer, np.stack(told)
    # But for rounding: SB3 stores actions scaled to [-1, 1], which is this box.
    np.testing.assert_allclose(executed, buffer.actions[: buffer.pos], atol=1e-6)
    rows = {key: values[: buffer.pos] for key, values in buffer.observations.items()}
    check_advised_blocks(model, executed, rows)


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["td3", "goal_td3"])
def test_executed_is_stored_with_workers(
    algorithm: str, models: list[Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    told = record(monkeypatch, SubprocVecEnv)
    more = ("--", "--vec-env", "subproc")
    assert main(tiny(algorithm, DUAL, tmp_path, *SOME, *more, steps=80)) == 0
    (model,) = models
    executed = np.stack(told)
    if algorithm == "td3":
        buffer = model.replay_buffer
        stored = buffer.actions[: buffer.pos]
    else:
        stored = goal_actions(model, len(executed))
    np.testing.assert_allclose(executed, stored, atol=1e-6)


@pytest.mark.parametrize("algorithm", ["goal_ddpg", "goal_td3", "goal_sac", "goal_tqc"])
def test_the_goal_learners_store_what_is_executed(
    algorithm: str, models: list[Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    told = record(monkeypatch, SaverVecEnv)
    assert main(tiny(algorithm, DUAL, tmp_path, *SOME)) == 0
    (model,) = models
    executed = np.stack(told)
    np.testing.assert_allclose(executed, goal_actions(model, len(executed)), atol=1e-6)
    assert int(model.replay_buffer.advised.sum()) == model.advisor.spent > 0


def goal_actions(model: Any, steps: int) -> Any:
    """(steps, n_envs, size) from the slots of whole episodes, in the order in which they began."""
    buffer = model.replay_buffer
    episodes = steps // buffer.horizon
    slots = buffer.action[: episodes * buffer.n_envs]
    by_step = slots.reshape(episodes, buffer.n_envs, buffer.horizon, -1).swapaxes(1, 2)
    return by_step.reshape(steps, buffer.n_envs, -1)


def run_folder(output: Path, algorithm: str, number: int = 1) -> Path:
    """RL Zoo's folder of a run."""
    return output / algorithm / f"{DUAL}_{number}"


def test_what_is_saved_is_readable_and_loads_everywhere(tmp_path: Path) -> None:
    assert main(tiny("td3", DUAL, tmp_path, *SOME)) == 0
    folder = run_folder(tmp_path, "advised_td3")
    text = (folder / DUAL / "config.yml").read_text()
    for line in ("strategy: mc-act", "teacher: jaco-push", "budget: 120", "threshold: 1.2"):
        assert line in text
    assert "python/object:" not in text
    env = BatchedVecEnv([lambda: _make(DUAL)])  # SB3's hindsight asks it for rewards
    plain = TD3.load(folder / f"{DUAL}.zip", env=env)
    assert type(plain) is TD3
    assert plain.advice_state["teachers"] == ["jaco-push"] * 2  # type: ignore[attr-defined]
    words = ["evaluate", "--env", DUAL, "--episodes", "2", "--env-kwargs", "max_episode_steps=10"]
    assert main([*words, "--policy", str(folder)]) == 0


@pytest.mark.parametrize("algorithm", ["sac", "goal_td3"])
def test_our_loader_and_theirs_agree(algorithm: str, models: list[Any], tmp_path: Path) -> None:
    from saver_advisors.zoo.runs import load_run

    assert main(tiny(algorithm, DUAL, tmp_path, settings=STARTING)) == 0
    name = f"advised_{algorithm}" if algorithm == "sac" else algorithm
    policy = load_run(run_folder(tmp_path, name))
    env = SaverVecEnv(DUAL, 3, seed=1)
    observation = env.reset()
    expected, _ = models[0].predict(observation, deterministic=True)
    np.testing.assert_allclose(
        policy.predict(observation, deterministic=True)[0], expected, atol=1e-6
    )


@pytest.mark.parametrize("algorithm", ["sac", "goal_td3"])
def test_a_resumed_run_goes_on_with_the_spent_budget(
    algorithm: str, models: list[Any], tmp_path: Path
) -> None:
    early = ("--advice", "early", "--teacher", "jaco-push", "--budget", "200")
    keep = ("--", "--save-replay-buffer")
    assert main(tiny(algorithm, DUAL, tmp_path, *early, *keep)) == 0
    assert models[0].advisor.spent == 160
    assert main(tiny(algorithm, DUAL, tmp_path, *early, "--resume")) == 0
    assert models[1].advisor.spent == 200
    if algorithm == "goal_td3":
        # Its replay buffer came back as well, without pickle.
        assert int(models[1].replay_buffer.advised.sum()) == 200
        assert models[1].replay_buffer.size() == 320


def test_a_student_starts_as_its_teachers_once(
    models: list[Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    begun: list[dict[str, Any]] = []
    learn = manager.SaverExperimentManager.learn

    def keep(self: Any, model: Any) -> None:
        begun.append(weights(model))
        learn(self, model)

    monkeypatch.setattr(manager.SaverExperimentManager, "learn", keep)
    assert main(tiny("goal_td3", DISTANCE, tmp_path, steps=20, settings=STARTING)) == 0
    (model,) = models
    learned = weights(model)
    assert any((begun[0][name] != value).any() for name, value in learned.items())
    model.actor.load_state_dict(begun[0])
    env = SaverVecEnv(DISTANCE, n_envs=4, seed=0)
    observation: Any = env.reset()
    env.close()
    mapping = model.advisor.mapping
    expected = model.advisor.teachers.act(
        mapping.split_observation(observation["observation"]),
        mapping.split_goal(observation["desired_goal"]),
    )
    action, _ = model.predict(observation, deterministic=True)
    np.testing.assert_allclose(mapping.split_action(action), expected, atol=1e-5)
    # A run that goes on does so with what was learned, not as the teachers anew.
    assert main(tiny("goal_td3", DISTANCE, tmp_path, "--resume", steps=20, settings=STARTING)) == 0
    assert all((begun[1][name] == value).all() for name, value in learned.items())


def weights(model: Any) -> dict[str, Any]:
    """A copy of an actor's."""
    return {name: value.clone() for name, value in model.actor.state_dict().items()}


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (TINY, "net_arch=[8] cannot hold the teachers side by side"),
        ((*STARTING, "replay_buffer_class=saver_advisors.Buffer"), "is unknown"),
        ((*STARTING, "callback=[{saver_advisors.variable_reward.StagesCallback: "
          "{stages: [{stage: resting}]}}]"), "stage='resting': must be one of"),
    ],
)  # fmt: skip
def test_settings_that_the_algorithm_refuses_are_told_in_a_line(
    settings: tuple[str, ...], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(tiny("goal_td3", DISTANCE, tmp_path, settings=settings)) == 2
    assert message in capsys.readouterr().err


def test_stages_go_on_where_a_run_was(models: list[Any], tmp_path: Path) -> None:
    env = DISTANCE
    words = ("--config", str(CONFIGS / "stages.yml"), "--advice", "early", "--budget", "60")
    assert main(tiny("goal_td3", env, tmp_path, *words, steps=100)) == 0
    state = {"stages": ["teaching", "stretching", "exploring"], "stage": "stretching"}
    assert models[0].stage_state == {**state, "switched_at": [60]}
    assert models[0].advisor.spent == 60
    text = (tmp_path / "goal_td3" / f"{env}_1" / env / "config.yml").read_text()
    for line in ("until: steps 133000", "ConstraintReplayBuffer", "constraint_relabelling: next"):
        assert line in text
    assert "python/object:" not in text
    assert main(tiny("goal_td3", env, tmp_path, *words, "--resume", steps=100)) == 0
    # RL Zoo counts from 0 again, and so does the stage.
    assert models[1].stage_state == {**state, "switched_at": [0]}
    assert models[1].advisor.spent == 60


@pytest.mark.parametrize("strategy", ["random", "jump-start"])
def test_strategies_are_told_about_the_run(
    strategy: str, models: list[Any], tmp_path: Path
) -> None:
    """They ask for its length and for that of an episode, which RL Zoo does not pass on."""
    advice = ("--advice", strategy, "--budget", "40")
    assert main(tiny("sac", DUAL, tmp_path, *advice, "--seed", "5")) == 0
    (model,) = models
    assert 0 < model.advisor.spent <= 40
    text = (run_folder(tmp_path, "advised_sac") / DUAL / "config.yml").read_text()
    for line in ("total_steps: 160", "horizon: 10", "seed: 5", f"strategy: {strategy}"):
        assert line in text


def test_resume_needs_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(tiny("sac", DUAL, tmp_path, "--resume")) == 2
    assert "argument --resume: there is no" in capsys.readouterr().err


def plain(algorithm: str, env: str, output: Path) -> list[str]:
    """The words of a plain run, with the settings made tiny."""
    values = {"policy_kwargs": {"net_arch": [8]}} | {
        name: yaml.safe_load(value)
        for name, value in (pair.split("=") for pair in TINY if "." not in pair)
    }
    return [
        *("--gym-packages", "saver_envs", "--conf-file", str(CONFIGS / f"{algorithm}.yml")),
        *("--algo", algorithm, "--env", env, "-f", str(output), "-n", "80", "--seed", "3"),
        *("--env-kwargs", "max_episode_steps:10", "--eval-freq", "20", "--log-interval", "1000"),
        "--hyperparams",
        *(f"{name}:{value!r}" for name, value in values.items()),
    ]


@pytest.mark.parametrize("algorithm", STOCK)
def test_plain_rl_zoo_takes_the_same_files(
    algorithm: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["rl_zoo3", *plain(algorithm, "JacoPush-v0", tmp_path)])
    rl_zoo3.train.train()
    (folder,) = (tmp_path / algorithm).iterdir()
    assert (folder / "JacoPush-v0.zip").is_file()
    assert (folder / "best_model.zip").is_file()
    header = (folder / "0.monitor.csv").read_text().splitlines()[1]
    assert "is_success" in header


class Asked(Exception):
    """An environment was about to be made."""


def kwargs_by_purpose(monkeypatch: pytest.MonkeyPatch, run: Any) -> dict[bool, dict[str, Any]]:
    """What RL Zoo gives to training environments (False) and evaluation ones (True)."""
    found: dict[bool, dict[str, Any]] = {}
    create = rl_zoo3.train.ExperimentManager.create_envs

    def look(self: Any, n_envs: int, eval_env: bool = False, no_log: bool = False) -> Any:
        found[eval_env] = dict(self.eval_env_kwargs if eval_env else self.env_kwargs)
        if not eval_env:
            raise Asked
        return create(self, n_envs, eval_env, no_log)

    monkeypatch.setattr(rl_zoo3.exp_manager.ExperimentManager, "create_envs", look)
    with pytest.raises(Asked):
        run()
    return found


def test_easier_starts_are_kept_from_evaluations(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """In plain RL Zoo 2.9 by what its manager leaves out, here by what it is told."""
    env = "JacoPickAndPlace-v0"
    with monkeypatch.context() as patch:
        words = tiny("sac", env, tmp_path, "--", "--eval-freq", "20")
        found = kwargs_by_purpose(patch, lambda: main(words))
    assert found[False] == {"max_episode_steps": 10, "in_hand_probability": 0.4}
    assert found[True] == {"max_episode_steps": 10, "in_hand_probability": 0.0}
    words = [
        *("--conf-file", str(CONFIGS / "sac.yml"), "--algo", "sac", "--env", env),
        *("-f", str(tmp_path), "--seed", "1"),
    ]
    monkeypatch.setattr(sys, "argv", ["rl_zoo3", *words])
    found = kwargs_by_purpose(monkeypatch, rl_zoo3.train.train)
    assert found[False] == {"in_hand_probability": 0.4}
    assert found[True] == {}


def test_the_best_model_is_the_one_that_succeeds_most_often(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of these three evaluations the first has the highest reward, the second most successes."""
    evaluations = deque([(-5.0, [1, 0, 0, 0]), (-9.0, [1, 1, 0, 0]), (-8.0, [0, 0, 0, 0])])
    env = BatchedVecEnv([lambda: _make("JacoPush-v0")] * 2)
    model = SAC("MultiInputPolicy", env, policy_kwargs={"net_arch": [8]}, buffer_size=100)
    model.learning_starts = 10**6
    best: list[int] = []
    monkeypatch.setattr(model, "save", lambda path: best.append(model.num_timesteps))

    def evaluate(*_: Any, callback: Any, **__: Any) -> tuple[list[float], list[int]]:
        reward, successes = evaluations.popleft()
        for success in successes:
            callback({"info": {"is_success": bool(success)}, "done": True}, {})
        return [reward] * 4, [50] * 4

    monkeypatch.setattr("stable_baselines3.common.callbacks.evaluate_policy", evaluate)
    callback = SuccessEvalCallback(
        env, eval_freq=1, best_model_save_path=str(tmp_path), n_eval_episodes=4, verbose=0
    )
    model.learn(6, callback=callback)
    assert best == [2, 4]
    assert callback.best_success_rate == 0.5


def _make(env_id: str) -> Any:
    return Monitor(gymnasium.make(f"saver_envs:{env_id}", max_episode_steps=10))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--zoo", "a2c"], "algorithm 'a2c' is unknown"),
        (["--zoo", "sac", "--algorithm", "td3"], "--algorithm: not available with --zoo"),
        (["--zoo", "sac", "--", "--algo", "td3"], "--algo: use --zoo of"),
        (["--zoo", "sac", "--", "-n=3"], "-n: use --steps of"),
        (["--zoo", "sac", "--teacher", "jaco-pick-and-place"], "does not fit|do not divide"),
        (
            ["--zoo", "sac", "--config", "README.md"],
            "hold names and values|neither YAML",
        ),
        (["--", "--save-freq", "3"], "--save-freq: only --zoo takes further arguments"),
    ],
)
def test_mistakes_are_named_before_anything_is_made(
    words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "logs"
    words = ["train", "--env", DUAL, "--output", str(output), *words]
    assert main(words) == 2
    assert re.search(message, capsys.readouterr().err)
    assert not output.exists()


def test_rl_zoo_is_left_as_it_was(tmp_path: Path) -> None:
    before = rl_zoo3.train.ExperimentManager, sys.argv
    zoo_program(["train", *plain("sac", "JacoPush-v0", tmp_path)])
    assert (rl_zoo3.train.ExperimentManager, sys.argv) == before
    assert before[0].default_vec_env_cls is None
    words = ["enjoy", "--algo", "sac", "--env", "JacoPush-v0", "--no-render", "-n", "20", "-f"]
    zoo_program([*words, str(tmp_path)])
    with pytest.raises(SystemExit, match="usage"):
        zoo_program(["play"])


@pytest.mark.parametrize("where", ["file", "command"])
def test_worlds_vary_under_rl_zoo(where: str, tmp_path: Path, monkeypatch: Any) -> None:
    """In training and in its evaluations, although a file's other arguments are for training."""
    made: list[dict[str, Any]] = []
    create = manager.SaverExperimentManager.create_envs

    def keep(self: Any, n_envs: int, eval_env: bool = False, no_log: bool = False) -> Any:
        venv = create(self, n_envs, eval_env, no_log)
        made.append(venv.get_attr("episodes", 0)[0].settings.randomization.as_json())
        return venv

    monkeypatch.setattr(manager.SaverExperimentManager, "create_envs", keep)
    more: list[str] = ["--randomization", "mild"]
    expected = varied_in("JacoPush-v0", {"randomization": "mild"})
    if where == "file":
        entry = yaml.safe_load((CONFIGS / "td3.yml").read_text())["default"]
        entry["env_kwargs"] = {"randomization": {"object_size": [0.04, 0.09]}}
        config = tmp_path / "td3.yml"
        config.write_text(yaml.safe_dump({"JacoPush-v0": entry}))
        more = ["--config", str(config)]
        expected = {"object_size": {"uniform": [0.04, 0.09]}}
    words = tiny("td3", "JacoPush-v0", tmp_path / "logs", *more, steps=80)
    at = words.index("--eval-freq")
    words[at + 1] = "40"
    assert main(words) == 0
    assert len(made) == 2  # for training and for evaluations
    assert made == [expected, expected]
    folder = tmp_path / "logs" / "td3" / "JacoPush-v0_1"
    arguments = ["evaluate", "--env", "JacoPush-v0", "--policy", str(folder), "--episodes", "2"]
    assert main([*arguments, "--randomization", "wide"]) == 0
