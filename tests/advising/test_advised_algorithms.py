"""What is executed is what is stored; budgets are exact; models save, load and resume."""

import io
import json
import zipfile

import numpy as np
import pytest
import torch
from sb3_contrib import TQC
from stable_baselines3 import DDPG, DQN, PPO, SAC, TD3
from stable_baselines3.common.buffers import DictReplayBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.vec_env import VecNormalize
from stable_baselines3.her import HerReplayBuffer
from toy_arms import ACTION, ARM_HIGH, ARM_LOW, N_ARMS, make_teacher, make_vec_env

from saver_advisors.advising import (
    AdvisedDDPG,
    AdvisedMixin,
    AdvisedSAC,
    AdvisedTD3,
    AdvisedTQC,
    AdvisingCallback,
    build_advised,
    make_advisor,
)
from saver_advisors.learner import GoalSAC, GoalTD3
from saver_advisors.policies.teacher import Teacher

ALGORITHMS = [DDPG, TD3, SAC, TQC]
N_ENVS, WARM_UP, STEPS = 4, 40, 120


class RecordingBuffer(DictReplayBuffer):
    """Keeps what it was told about advice."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.advised, self.arms = [], []

    def add(self, obs, next_obs, action, reward, done, infos):
        self.advised.append([info.get("advised") for info in infos])
        self.arms.append([info.get("advised_arms") for info in infos])
        super().add(obs, next_obs, action, reward, done, infos)


def make_model(algorithm, env, **arguments):
    if issubclass(algorithm, TD3):
        noise = NormalActionNoise(np.zeros(N_ARMS * ACTION), 0.3 * np.ones(N_ARMS * ACTION))
        arguments.setdefault("action_noise", noise)
    arguments.setdefault("replay_buffer_class", RecordingBuffer)
    return algorithm(
        "MultiInputPolicy",
        env,
        learning_starts=WARM_UP,
        buffer_size=2000,
        batch_size=16,
        policy_kwargs={"net_arch": [16]},
        train_freq=2,
        gradient_steps=1,
        seed=0,
        **arguments,
    )


def executed_actions(env):
    """(steps, n_envs, size), what the environments were really told."""
    return np.stack(env.env_method("executed_actions"), axis=1)


def stored(model):
    """Observations, and actions in the environment's units, by step and environment."""
    buffer = model.replay_buffer
    rows = {key: values[: buffer.pos] for key, values in buffer.observations.items()}
    return rows, model.policy.unscale_action(buffer.actions[: buffer.pos])


def teacher_actions(advisor, rows):
    """(steps, n_envs, size), what the teachers would have done, clipped to the box."""
    steps, n_envs = rows["observation"].shape[:2]
    flat = {key: values.reshape(steps * n_envs, -1) for key, values in rows.items()}
    mapping = advisor.mapping
    actions = advisor.teachers.act(
        mapping.split_observation(flat["observation"]),
        mapping.split_goal(flat["desired_goal"]),
        mapping.split_goal(flat["achieved_goal"]),
    )
    actions = np.clip(actions, ARM_LOW, ARM_HIGH)
    return mapping.join_actions(actions).reshape(steps, n_envs, -1)


def check_advice(model, advisor, env):
    """Executed equals stored everywhere; advised blocks are the teacher's, the others are not."""
    executed, (rows, actions) = executed_actions(env), stored(model)
    assert len(executed) == STEPS // N_ENVS
    np.testing.assert_allclose(executed, actions, atol=1e-5)
    mask = np.repeat(np.array(model.replay_buffer.arms), ACTION, axis=2)
    expected = teacher_actions(advisor, rows)
    assert 0.05 < mask.mean() < 0.95, "the case must have both advised and unadvised blocks"
    np.testing.assert_allclose(executed[mask], expected[mask], atol=1e-5)
    assert (np.abs(executed - expected)[~mask] > 1e-4).mean() > 0.9
    np.testing.assert_array_equal(np.array(model.replay_buffer.advised), mask.any(axis=2))
    assert int(mask.any(axis=2).sum()) == advisor.spent


@pytest.mark.parametrize("way", ["mixin", "callback"])
@pytest.mark.parametrize("subprocess", [False, True], ids=["dummy", "subproc"])
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_executed_is_stored(algorithm, subprocess, way):
    advisor = make_advisor("mc-act", make_teacher(), 1000, n_arms=2, threshold=2.0)
    env = make_vec_env(N_ENVS, subprocess=subprocess)
    try:
        if way == "mixin":
            model = make_model(build_advised(algorithm), env, advisor=advisor).learn(STEPS)
        else:
            model = make_model(algorithm, env).learn(STEPS, callback=AdvisingCallback(advisor))
        check_advice(model, advisor, env)
    finally:
        env.close()


@pytest.mark.parametrize("algorithm", [GoalTD3, GoalSAC])
def test_composes_with_the_learner_room(algorithm):
    """Its mixin overrides `_sample_action` too, with uniform actions in between."""
    advisor = make_advisor("mc-act", make_teacher(), 1000, n_arms=2, threshold=2.0)
    env = make_vec_env(N_ENVS)
    buffer = {"replay_buffer_class": None, "replay_buffer_kwargs": {"horizon": 10}}
    model = make_model(
        build_advised(algorithm), env, advisor=advisor, random_action_probability=0.3, **buffer
    ).learn(STEPS)
    replay = model.replay_buffer
    executed = executed_actions(env).reshape(3, 10, N_ENVS, -1).swapaxes(1, 2)
    actions = model.policy.unscale_action(replay.action[: 3 * N_ENVS]).reshape(executed.shape)
    np.testing.assert_allclose(executed, actions, atol=1e-5)
    assert int(replay.advised.sum()) == advisor.spent > 0


def test_works_with_hindsight():
    advisor = make_advisor("early", make_teacher(), 30, n_arms=2)
    env = make_vec_env(N_ENVS)
    kwargs = {"replay_buffer_class": HerReplayBuffer, "replay_buffer_kwargs": {"n_sampled_goal": 4}}
    model = make_model(AdvisedTD3, env, advisor=advisor, **kwargs).learn(STEPS)
    _, actions = stored(model)
    np.testing.assert_allclose(executed_actions(env), actions, atol=1e-5)
    assert advisor.spent == 30


@pytest.mark.parametrize("n_envs", [1, 3, 8])
def test_the_budget_is_exact_and_goes_to_the_first(n_envs):
    advisor = make_advisor("early", make_teacher(), 37, n_arms=2)
    model = make_model(AdvisedSAC, make_vec_env(n_envs), advisor=advisor).learn(80)
    flags = np.array(model.replay_buffer.advised).reshape(-1)
    assert flags.tolist() == [True] * 37 + [False] * (len(flags) - 37)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_no_advice_changes_nothing(algorithm):
    """Bit for bit: neither random numbers nor weights differ from the plain algorithm's."""
    plain = make_model(algorithm, make_vec_env(2)).learn(STEPS)
    advisor = make_advisor("none", make_teacher(), 100, n_arms=2)
    advised = make_model(build_advised(algorithm), make_vec_env(2), advisor=advisor).learn(STEPS)
    np.testing.assert_array_equal(stored(plain)[1], stored(advised)[1])
    for one, other in zip(plain.policy.parameters(), advised.policy.parameters(), strict=True):
        assert torch.equal(one, other)


def test_callback_and_mixin_are_the_same():
    advisors = [
        make_advisor("mc-q", make_teacher(), 60, n_arms=2, threshold=0.05) for _ in range(2)
    ]
    mixin = make_model(AdvisedTD3, make_vec_env(2), advisor=advisors[0]).learn(STEPS)
    stock = make_model(TD3, make_vec_env(2))
    stock.learn(STEPS, callback=AdvisingCallback(advisors[1]))
    assert advisors[0].state_dict() == advisors[1].state_dict()
    assert advisors[0].spent > 0
    np.testing.assert_array_equal(stored(mixin)[1], stored(stock)[1])


def test_the_callback_leaves_a_stock_model_behind():
    model = make_model(TD3, make_vec_env(2))
    advisor = make_advisor("early", make_teacher(), 30, n_arms=2)
    model.learn(40, callback=AdvisingCallback(advisor))
    assert type(model) is TD3
    assert "advisor" not in vars(model)
    assert model.advice_state["budget"]["spent"] == 30
    before = advisor.spent
    model.learn(20)
    assert advisor.spent == before
    # And on again, with the same advisor and the rest of a larger budget.
    more = make_advisor("early", make_teacher(), 50, n_arms=2)
    more.load_state_dict(model.advice_state)
    model.learn(100, callback=AdvisingCallback(more), reset_num_timesteps=False)
    assert more.spent == 50


class Interrupt(BaseCallback):
    def _on_step(self):
        raise KeyboardInterrupt


def test_a_training_that_breaks_off_does_no_harm():
    model = make_model(TD3, make_vec_env(2))
    first, second = (make_advisor("early", make_teacher(), 100, n_arms=2) for _ in range(2))
    with pytest.raises(KeyboardInterrupt):
        model.learn(40, callback=[AdvisingCallback(first), Interrupt()])
    model.learn(20, callback=AdvisingCallback(second))
    assert (first.spent, second.spent) == (2, 20)
    with pytest.raises(KeyboardInterrupt):
        model.learn(40, callback=[AdvisingCallback(first), Interrupt()])
    model.learn(20)
    assert type(model) is TD3
    assert first.spent == 4


class SaveOnce(BaseCallback):
    """Writes a checkpoint in the middle of training, as SB3's CheckpointCallback does."""

    def __init__(self):
        super().__init__()
        self.file = io.BytesIO()

    def _on_step(self):
        if self.n_calls == 10:
            self.model.save(self.file)
        return True


@pytest.mark.parametrize("way", ["mixin", "callback"])
def test_a_checkpoint_holds_the_state_and_no_teacher(way):
    advisor = make_advisor("early", make_teacher(name="the-teacher"), 1000, n_arms=2)
    saver = SaveOnce()
    if way == "mixin":
        make_model(AdvisedTD3, make_vec_env(2), advisor=advisor).learn(40, callback=saver)
    else:
        model = make_model(TD3, make_vec_env(2))
        model.learn(40, callback=[AdvisingCallback(advisor), saver])
    saver.file.seek(0)
    with zipfile.ZipFile(saver.file) as archive:
        data = json.loads(archive.read("data"))
    assert "advisor" not in data
    assert "_advice_mask" not in data
    saver.file.seek(0)
    plain = TD3.load(saver.file)
    assert plain.advice_state["budget"] == {"total": 1000, "spent": 20}
    assert plain.advice_state["strategy"] == "early"
    assert plain.advice_state["teachers"] == ["the-teacher"] * 2


@pytest.mark.parametrize("advised", [AdvisedDDPG, AdvisedTD3, AdvisedSAC, AdvisedTQC])
def test_load_and_resume(advised, tmp_path):
    advisor = make_advisor("early", make_teacher(), 50, n_arms=2)
    model = make_model(advised, make_vec_env(2), advisor=advisor).learn(40)
    model.save(tmp_path / "model.zip")
    observation = model._last_obs
    expected, _ = model.predict(observation, deterministic=True)

    without = advised.load(tmp_path / "model.zip", env=make_vec_env(2))
    np.testing.assert_allclose(without.predict(observation, deterministic=True)[0], expected)
    assert without.advisor is None
    without.learn(20)
    assert without.replay_buffer.advised[-1] == [None, None]
    # Saved again without an advisor, it still knows what was spent.
    without.save(tmp_path / "again.zip")
    assert advised.load(tmp_path / "again.zip").advice_state["budget"]["spent"] == 40

    fresh = make_advisor("early", make_teacher(), 50, n_arms=2)
    resumed = advised.load(tmp_path / "model.zip", env=make_vec_env(2), advisor=fresh)
    fresh.load_state_dict(resumed.advice_state)
    resumed.learn(20, reset_num_timesteps=False)
    flags = np.array(resumed.replay_buffer.advised).reshape(-1)
    assert flags.tolist() == [True] * 10 + [False] * 10

    plain_class = advised.__bases__[1]
    plain = plain_class.load(tmp_path / "model.zip")
    np.testing.assert_allclose(plain.predict(observation, deterministic=True)[0], expected)


def test_a_resumed_run_that_forgets_its_spending_is_warned(tmp_path):
    advisor = make_advisor("early", make_teacher(), 50, n_arms=2)
    make_model(AdvisedTD3, make_vec_env(2), advisor=advisor).learn(40).save(tmp_path / "model.zip")
    fresh = make_advisor("early", make_teacher(), 50, n_arms=2)
    model = AdvisedTD3.load(tmp_path / "model.zip", env=make_vec_env(2), advisor=fresh)
    with pytest.warns(UserWarning, match="40 advised steps, but its .*load_state_dict"):
        model.learn(4)


def test_the_teacher_sees_what_the_environment_said():
    """Under VecNormalize the student's observation is normalised, the teacher's is not."""
    env = VecNormalize(make_vec_env(N_ENVS), norm_obs=True, norm_reward=False)
    advisor = make_advisor("early", make_teacher(), 1000, n_arms=2)
    model = make_model(AdvisedTD3, env, advisor=advisor).learn(STEPS)
    # SB3 stores original observations.
    rows, actions = stored(model)
    np.testing.assert_allclose(executed_actions(env), actions, atol=1e-5)
    np.testing.assert_allclose(actions, teacher_actions(advisor, rows), atol=1e-5)


class Spy:
    """Advises nobody and remembers whom it compared."""

    name = "spy"
    needs_critics = False

    def __init__(self):
        self.seen, self.settings = [], {}

    def decide(self, context):
        self.seen.append(context.student_actions.copy())
        return np.zeros(context.shape, bool)


@pytest.mark.parametrize("compare", ["noisy", "noise-free"])
@pytest.mark.parametrize("algorithm", [AdvisedTD3, AdvisedSAC])
def test_which_student_action_is_compared(algorithm, compare):
    spy = Spy()
    advisor = make_advisor(spy, make_teacher(), 100, n_arms=2, compare=compare)
    env = make_vec_env(N_ENVS)
    # No training, so that the policy of the end is the policy of every step.
    model = make_model(algorithm, env, advisor=advisor)
    model.gradient_steps = 0
    model.learn(STEPS)
    rows, executed = stored(model)[0], executed_actions(env)
    flat = {key: values.reshape(STEPS, -1) for key, values in rows.items()}
    noise_free = model.predict(flat, deterministic=True)[0].reshape(executed.shape)
    seen = np.array(spy.seen).reshape(executed.shape)
    expected, other = (executed, noise_free) if compare == "noisy" else (noise_free, executed)
    np.testing.assert_allclose(seen, expected, atol=1e-5)
    assert np.abs(seen - other).max() > 0.1


def test_teacher_actions_are_clipped_to_the_students_box():
    networks = make_teacher().networks
    networks.action_high.fill_(50.0)
    teacher = Teacher(networks)
    advisor = make_advisor("early", teacher, 1000, n_arms=2)
    env = make_vec_env(N_ENVS)
    model = make_model(AdvisedTD3, env, advisor=advisor).learn(STEPS)
    executed = executed_actions(env)
    assert executed.max() <= 4.0
    assert np.isclose(executed[..., 0], 4.0).any()
    np.testing.assert_allclose(executed, stored(model)[1], atol=1e-5)


@pytest.mark.parametrize("way", ["mixin", "callback"])
def test_advice_figures_are_logged(way, tmp_path):
    advisor = make_advisor("early", make_teacher(), 20, n_arms=2)
    if way == "mixin":
        model, callback = make_model(AdvisedTD3, make_vec_env(2), advisor=advisor), None
    else:
        model, callback = make_model(TD3, make_vec_env(2)), AdvisingCallback(advisor)
    model.set_logger(configure(str(tmp_path), ["json"]))
    # Two environments with episodes of 10 steps: a line every 2 episodes is one every 20 steps.
    model.learn(60, callback=callback, log_interval=2)
    lines = [json.loads(line) for line in (tmp_path / "progress.json").read_text().splitlines()]
    assert [line["advice/spent"] for line in lines] == [20] * 3
    assert [line["advice/remaining"] for line in lines] == [0] * 3
    # Each line tells of its own window: all of the first was advised, nothing after it.
    assert [line["advice/share"] for line in lines] == [1.0, 0.0, 0.0]
    assert [line["advice/share_arm_1"] for line in lines] == [1.0, 0.0, 0.0]
    assert ["advice/disagreement" in line for line in lines] == [True, False, False]


def test_an_advisor_may_come_from_a_configuration_file():
    config = {"strategy": "mc-act", "teacher": make_teacher(), "budget": 10, "threshold": 0.5}
    model = make_model(AdvisedTD3, make_vec_env(2), advisor=config)
    assert model.advisor.budget.total == 10
    assert model.advisor.mapping.n_arms == 2
    assert model.learn(40).advisor.spent == 10


def test_an_advisor_from_a_configuration_file_goes_on_with_its_budget(tmp_path):
    """As RL Zoo resumes: it hands the file's words to `load`, and cannot call anything else."""
    config = {"strategy": "early", "teacher": make_teacher(), "budget": 50}
    make_model(AdvisedTD3, make_vec_env(2), advisor=config).learn(40).save(tmp_path / "model.zip")
    resumed = AdvisedTD3.load(tmp_path / "model.zip", env=make_vec_env(2), advisor=config)
    assert resumed.advisor.spent == 40
    resumed.learn(40)
    assert resumed.advisor.spent == 50
    smaller = {**config, "budget": 30}
    with pytest.raises(ValueError, match="spent=40 exceeds this budget's total of 30"):
        AdvisedTD3.load(tmp_path / "model.zip", env=make_vec_env(2), advisor=smaller)


def test_ending_twice_leaves_a_stock_model_a_stock_model():
    """RL Zoo ends the first callback once more than SB3 does."""
    callback = AdvisingCallback(make_advisor("early", make_teacher(), 30, n_arms=2))
    model = make_model(TD3, make_vec_env(2)).learn(20, callback=callback)
    callback.on_training_end()
    assert type(model) is TD3
    assert "advisor" not in vars(model)
    assert model.advice_state["budget"]["spent"] == 20


def test_ready_made_and_built_classes_are_one():
    assert build_advised(TD3) is AdvisedTD3
    assert build_advised(AdvisedTD3) is AdvisedTD3
    assert build_advised(DDPG) is AdvisedDDPG
    assert build_advised(GoalTD3) is build_advised(GoalTD3)
    assert build_advised(GoalTD3).__mro__[1:3] == (AdvisedMixin, GoalTD3)


def test_on_policy_algorithms_are_refused():
    with pytest.raises(TypeError, match=r"PPO cannot be advised.*DDPG, TD3, SAC, TQC"):
        build_advised(PPO)
    model = PPO("MultiInputPolicy", make_vec_env(1), n_steps=8, batch_size=8)
    callback = AdvisingCallback(make_advisor("early", make_teacher(), 10, n_arms=2))
    with pytest.raises(TypeError, match="PPO cannot be advised"):
        model.learn(8, callback=callback)
    assert model.num_timesteps == 0


@pytest.mark.parametrize("way", ["mixin", "callback", "exchanged"])
def test_misfits_are_refused_before_training_starts(way):
    advisor = make_advisor("early", make_teacher(), 10, n_arms=3)
    env = make_vec_env(1)
    match = r"does not fit this student: .*size 8, but 3 arm\(s\) of 4 need 12"
    if way == "mixin":
        with pytest.raises(ValueError, match=match):
            make_model(AdvisedTD3, env, advisor=advisor)
        return
    model = make_model(AdvisedTD3 if way == "exchanged" else TD3, env)
    callback = None
    if way == "exchanged":
        model.advisor = advisor
    else:
        callback = AdvisingCallback(advisor)
    with pytest.raises(ValueError, match=match):
        model.learn(20, callback=callback)
    assert model.num_timesteps == 0


def test_two_advisors_for_one_model_are_refused():
    first, second = (make_advisor("early", make_teacher(), 10, n_arms=2) for _ in range(2))
    model = make_model(AdvisedTD3, make_vec_env(1), advisor=first)
    with pytest.raises(ValueError, match="another advisor"):
        model.learn(20, callback=AdvisingCallback(second))


def test_discrete_actions_are_refused():
    advisor = make_advisor("early", make_teacher(), 10, n_arms=2)
    with pytest.raises(TypeError, match="Dict observation"):
        build_advised(DQN)("MlpPolicy", "CartPole-v1", buffer_size=100, advisor=advisor)
