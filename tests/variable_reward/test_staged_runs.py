"""Stages in force on a learner: in a run, stopped and resumed in each of them, and by callback."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th
from stable_baselines3 import PPO, SAC, HerReplayBuffer
from stable_baselines3.common.vec_env import VecEnv

from saver_advisors.advising import build_advised, make_advisor
from saver_advisors.learner import GoalTD3
from saver_advisors.learner.replay import GoalReplayBuffer
from saver_advisors.training.building import build_model, build_stages
from saver_advisors.training.curve_file import OF_THE_MACHINE, read_curve
from saver_advisors.training.launch import train
from saver_advisors.training.settings import RunConfig
from saver_advisors.variable_reward import StageControl, StagesCallback, SwitchRule, TrainingStage
from saver_envs.envs.sb3_vec_env import SaverVecEnv

ENV, TEACHER, HORIZON, N_ENVS = "DualJacoDistance-v0", "jaco-pick-and-place", 10, 2
BLOCK = HORIZON * N_ENVS
SETTINGS: dict[str, Any] = {
    "env_id": ENV,
    "env_kwargs": {"max_episode_steps": HORIZON},
    "n_envs": N_ENVS,
    "total_steps": 9 * BLOCK,
    "net_arch": [8],
    "batch_size": 16,
    "gradient_steps": 2,
    "buffer_size": 10 * BLOCK,
    "eval_every": BLOCK,
    "eval_episodes": 2,
    "checkpoint_every": BLOCK,
    "constraint_relabelling": "next",
    "advice": {"strategy": "early", "teacher": TEACHER, "budget": 3 * BLOCK},
    "stages": [
        {"stage": "teaching", "until": "budget"},
        {"stage": "stretching", "until": f"steps {3 * BLOCK}"},
        {"stage": "exploring"},
    ],
}
THREE = (
    TrainingStage("teaching", SwitchRule("budget")),
    TrainingStage("stretching", SwitchRule("steps", 2 * BLOCK)),
    TrainingStage("exploring"),
)


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    th.set_num_threads(1)


@pytest.fixture
def env() -> Iterator[VecEnv]:
    made = SaverVecEnv(ENV, n_envs=N_ENVS, seed=0, max_episode_steps=HORIZON)
    yield made
    made.close()


def settings(**changes: Any) -> RunConfig:
    return RunConfig.from_mapping(json.loads(json.dumps({**SETTINGS, **changes})))


def without_clock(folder: Path) -> list[dict[str, Any]]:
    return [{k: v for k, v in p.items() if k not in OF_THE_MACHINE} for p in read_curve(folder)]


@pytest.mark.parametrize("apart", [False, True])
def test_stopped_in_each_stage_a_run_goes_on_as_if_it_had_not(tmp_path: Path, apart: bool) -> None:
    config = settings(per_arm_critics=apart)
    train(config, tmp_path / "whole", progress=False)
    for stop in (2 * BLOCK, 5 * BLOCK, 8 * BLOCK, 9 * BLOCK):
        train(config, tmp_path / "parts", resume=True, progress=False, stop_after_steps=stop)
    whole, parts = without_clock(tmp_path / "whole"), without_clock(tmp_path / "parts")
    assert parts == whole
    # A point tells the stage that its steps were done in.
    stages = [point["stage"] for point in whole]
    assert stages == [name for name in ("teaching", "stretching", "exploring") for _ in range(3)]
    assert [point["advice_spent"] for point in whole][2:] == [3 * BLOCK] * 7
    assert {"goal_success_rate", "constraint_met_rate"} <= whole[0].keys()


@pytest.mark.long
def test_killed_in_each_stage_a_run_goes_on_as_if_it_had_not(tmp_path: Path) -> None:
    """Kill -9 at any moment: what was done since the last checkpoint is done once more."""
    config = tmp_path / "config.yml"
    long = {"eval_episodes": 100, "total_steps": 9 * BLOCK}
    config.write_text(json.dumps({**SETTINGS, **long}), encoding="utf-8")
    train(settings(**long), tmp_path / "whole", progress=False)
    folder = tmp_path / "killed"
    words = [sys.executable, "-m", "saver_advisors.cli", "train", "--no-progress"]
    words += ["--config", str(config), "--output", str(folder), "--resume"]
    killed = []
    for points in (1, 4, 7):  # teaching, stretching and exploring have three each
        process = subprocess.Popen(words, env={**os.environ, "OMP_NUM_THREADS": "1"})
        deadline = time.monotonic() + 120
        while len(done := read_curve(folder) if folder.exists() else []) < points:
            assert process.poll() is None, "it must run until it is killed"
            assert time.monotonic() < deadline
            time.sleep(0.002)
        process.kill()
        process.wait()
        killed.append(done[-1]["stage"])
    assert killed == ["teaching", "stretching", "exploring"]
    subprocess.run(words, check=True, env={**os.environ, "OMP_NUM_THREADS": "1"})
    assert without_clock(folder) == without_clock(tmp_path / "whole")


def test_advice_ends_with_teaching_even_where_budget_is_left(tmp_path: Path) -> None:
    stages = [{"stage": "teaching", "until": f"steps {BLOCK}"}, {"stage": "exploring"}]
    train(settings(stages=stages), tmp_path, progress=False, stop_after_steps=3 * BLOCK)
    assert [point["advice_spent"] for point in read_curve(tmp_path)] == [BLOCK] * 3


def test_the_actor_minds_the_constraints_value_in_exploring_alone(env: VecEnv) -> None:
    config = settings(per_arm_critics=True, constraint_value_weight=2.0)
    model: Any = build_model(config, env)
    control = build_stages(config, model)
    assert control is not None
    assert model.value_weights == (1.0, 1.0, 0.0)
    model.advisor.budget.spend(np.ones(3 * BLOCK, dtype=bool))
    assert control.advance()
    assert (control.stage.name, model.value_weights) == ("stretching", (1.0, 1.0, 0.0))
    model.num_timesteps = 3 * BLOCK
    assert control.advance()
    assert (control.stage.name, model.value_weights) == ("exploring", (1.0, 1.0, 2.0))


def test_weights_decide_what_the_actor_climbs(env: VecEnv) -> None:
    """With all the weight on one part, a step of the actor raises that part's value."""
    model: Any = build_model(settings(per_arm_critics=True, advice=None, stages=None), env)
    model.learn(3 * BLOCK)
    model.policy.critic.action_penalty = 0.0
    drawn = model.replay_buffer.sample_transitions(64)
    batch = model.replay_buffer.as_samples(drawn)
    gains = []
    for part in range(3):
        model.value_weights = tuple(float(part == other) for other in range(3))
        before = {name: value.clone() for name, value in model.actor.state_dict().items()}
        # Plain steps, without what Adam remembers of other objectives.
        model.actor.optimizer = th.optim.SGD(model.actor.parameters(), lr=1e-3)
        values = []
        for _ in range(2):
            with th.no_grad():
                own = model.critic.q1_forward(batch.observations, model.actor(batch.observations))
            values.append(float(own[:, part].mean()))
            model._update_actor(batch, drawn)
        gains.append(values[1] - values[0])
        model.actor.load_state_dict(before)
    assert min(gains) > 0, gains


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"advice": None}, "needs a teacher"),
        ({"stages": [{"stage": "exploring", "until": "steps 5"}, {"stage": "stretching"}]},
         "order is"),
        ({"stages": [{"stage": "teaching", "until": "someday"}, {"stage": "exploring"}]}, "until="),
        ({"env_id": "DualJacoPickAndPlace-v0", "constraint_relabelling": None}, "a constraint"),
        ({"env_id": "DualJacoPickAndPlace-v0"}, "a constraint's value must follow"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_before_a_step(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        train(settings(**changes), tmp_path / "run", progress=False)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"constraint_relabelling": "past"}, "constraint_relabelling=past"),
        ({"constraint_value_weight": -1}, "constraint_value_weight=-1"),
        ({"stages": [{"until": "budget"}]}, "stages.stage must be given"),
        ({"stages": [{"stage": "teaching", "after": 1}]}, "unknown stages.after"),
    ],
)
def test_settings_that_cannot_be(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        settings(**changes)


# By callback ------------------------------------------------------------------------------------


def advisor_for(env: VecEnv) -> Any:
    spaces = {"observation_space": env.observation_space, "action_space": env.action_space}
    return make_advisor("early", TEACHER, 2 * BLOCK, **spaces)


def callback_model(env: VecEnv) -> Any:
    return build_advised(GoalTD3)(
        "MultiInputPolicy",
        env,
        advisor=advisor_for(env),
        buffer_size=20 * BLOCK,
        batch_size=16,
        train_freq=(HORIZON, "step"),
        gradient_steps=1,
        policy_kwargs={"net_arch": [8]},
        device="cpu",
        seed=0,
    )


def test_a_callback_runs_the_stages_and_a_saved_model_goes_on(env: VecEnv, tmp_path: Path) -> None:
    model = callback_model(env)
    callback = StagesCallback(THREE)
    model.learn(3 * BLOCK, callback)
    assert callback.control is not None
    assert callback.control.stage.name == "stretching"
    model.save(tmp_path / "model.zip")
    loaded = type(model).load(tmp_path / "model.zip", env=env)
    assert loaded.stage_state["stage"] == "stretching"
    loaded.advisor = advisor_for(env)
    loaded.advisor.load_state_dict(loaded.advice_state)
    again = StagesCallback(THREE)
    loaded.learn(2 * BLOCK, again, reset_num_timesteps=False)
    assert again.control is not None
    assert again.control.stage.name == "exploring"
    assert again.control.state_dict()["switched_at"][0] == 2 * BLOCK


def test_a_callback_takes_names_and_numbers() -> None:
    callback = StagesCallback(
        [
            {"stage": "teaching", "until": "budget"},
            {"stage": "stretching", "until": f"steps {2 * BLOCK}"},
            {"stage": "exploring"},
        ]
    )
    assert callback.stages == THREE
    with pytest.raises(ValueError, match="their order is"):
        StagesCallback([{"stage": "exploring", "until": "steps 5"}, {"stage": "teaching"}])


def test_steps_that_begin_anew_begin_the_stage_anew(env: VecEnv) -> None:
    model = callback_model(env)
    model.learn(3 * BLOCK, StagesCallback(THREE))
    assert model.stage_state["switched_at"] == [2 * BLOCK]
    again = StagesCallback(THREE)
    model.learn(BLOCK, again)
    assert again.control is not None
    assert again.control.stage.name == "stretching"
    model.learn(BLOCK, again, reset_num_timesteps=False)
    assert again.control.stage.name == "exploring"
    assert again.control.state_dict()["switched_at"] == [0, 2 * BLOCK]


def test_a_buffer_that_keeps_old_rewards_is_refused(env: VecEnv) -> None:
    model = SAC(
        "MultiInputPolicy",
        env,
        replay_buffer_class=HerReplayBuffer,
        buffer_size=20 * BLOCK,
        learning_starts=10 * BLOCK,
        device="cpu",
    )
    with pytest.raises(TypeError, match="HerReplayBuffer keeps rewards of an earlier stage"):
        StageControl(model, [TrainingStage("exploring")])


def test_an_on_policy_algorithm_is_refused(env: VecEnv) -> None:
    model = PPO("MultiInputPolicy", env, n_steps=4, batch_size=8, device="cpu")
    with pytest.raises(TypeError, match="PPO has no replay buffer"):
        model.learn(8, StagesCallback([TrainingStage("exploring")]))


def test_exploring_rewards_the_constraint(env: VecEnv) -> None:
    model = callback_model(env)
    control = StageControl(model, THREE)
    buffer = model.replay_buffer
    assert isinstance(buffer, GoalReplayBuffer)
    at_goal, asked = np.zeros((1, 7), np.float32), np.zeros((1, 7), np.float32)
    at_goal[:, 6], asked[:, 6] = 0.5, 0.35
    for name, reward in (("teaching", 0), ("stretching", 0), ("exploring", -1)):
        assert control.stage.name == name
        assert buffer.reward_function is not None
        assert buffer.reward_function(at_goal, asked)[0] == reward
        model.num_timesteps += 2 * BLOCK
        model.advisor.budget.spend(np.ones(2 * BLOCK, dtype=bool))
        control.advance()
