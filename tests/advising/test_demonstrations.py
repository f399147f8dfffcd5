"""Teachers that fill a second buffer, batches half from each, and a student cloned from them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy_arms import ACTION, N_ARMS, make_vec_env
from toy_runs import (
    BLOCK,
    BLOCKS,
    HORIZON,
    N_ENVS,
    advisor_state,
    assert_resumes_exactly,
    curve,
    replay,
    save_teacher,
    settings,
    start,
    steps_taken,
)

from saver_advisors.learner import reward_function_of
from saver_advisors.learner.imitation import clone
from saver_advisors.learner.replay import DemonstrationReplayBuffer
from saver_advisors.pretrained import load_teacher, side_by_side
from saver_advisors.training.building import build_model
from saver_advisors.training.launch import load_trained


def advice(folder: Path, **more: Any) -> dict[str, Any]:
    return {
        "strategy": "none",
        "teacher": save_teacher(folder),
        "budget": 2 * BLOCK,
        "demonstration_steps": BLOCK + 1,
        **more,
    }


def demonstrated_model(folder: Path, steps: int = 4 * BLOCK, **changes: Any) -> Any:
    """A learner whose teachers have demonstrated, and its buffer."""
    given = advice(folder, demonstration_steps=steps, budget=steps)
    model: Any = build_model(settings(given, **changes), make_vec_env(N_ENVS))
    model._last_obs = model.env.reset()
    model.demonstrate(steps, model.replay_buffer.demonstrations)
    return model


def teachers_actions(model: Any, rows: dict[str, Any]) -> Any:
    pair = side_by_side(model.advisor.teachers.teachers, N_ARMS)
    return model.policy.scale_action(pair.predict(rows)[0]).astype(np.float32)


def rows_of(drawn: Any) -> dict[str, Any]:
    return {
        "observation": drawn.observation,
        "achieved_goal": drawn.achieved_goal,
        "desired_goal": drawn.desired_goal,
    }


@pytest.mark.parametrize("algorithm", ["td3", "sac"])
def test_a_run_begins_with_demonstrations(tmp_path: Path, algorithm: str) -> None:
    """Rounded up to whole episodes, they count as steps and as advice."""
    envs: list[Any] = []
    config = settings(advice(tmp_path), algorithm=algorithm)
    result = start(config, tmp_path / "run", envs=envs)
    assert result.steps == BLOCKS * BLOCK == steps_taken(envs[0])
    assert result.updates == (BLOCKS - 2) * 4
    lines = curve(tmp_path / "run")
    assert [line["advice_spent"] for line in lines] == [BLOCK, *[2 * BLOCK] * (BLOCKS - 1)]
    assert advisor_state(tmp_path / "run")["advised_per_arm"] == [2 * BLOCK] * N_ARMS
    shown, own = replay(tmp_path / "run", "demonstrations"), replay(tmp_path / "run")
    assert shown["advised"].all()
    assert shown["length"].tolist() == [HORIZON] * 2 * N_ENVS
    assert not own["advised"].any()
    assert own["length"].sum() == (BLOCKS - 2) * BLOCK


def test_demonstrations_are_the_teachers_and_what_was_executed(tmp_path: Path) -> None:
    model = demonstrated_model(tmp_path)
    shown = model.replay_buffer.demonstrations
    drawn = shown.sample_transitions(200)
    drawn = replace(drawn, desired_goal=drawn.episode_goal)
    np.testing.assert_allclose(
        drawn.action, np.clip(teachers_actions(model, rows_of(drawn)), -1, 1), atol=1e-5
    )
    executed = np.stack(model.env.env_method("executed_actions"), axis=1)
    stored = model.policy.unscale_action(shown.action[: 4 * N_ENVS])
    stored = stored.reshape(4, N_ENVS, HORIZON, -1).swapaxes(1, 2).reshape(executed.shape)
    np.testing.assert_allclose(executed, stored, atol=1e-5)
    # The normaliser has seen each of them twice, as it sees the student's own.
    assert (model.policy.shared_features.count == 2 * 4 * BLOCK).all()


@pytest.mark.parametrize(("share", "expected"), [(0.5, 32), (0.25, 16), (0.0, 0)])
def test_batches_are_drawn_from_both(tmp_path: Path, share: float, expected: int) -> None:
    model = demonstrated_model(tmp_path)
    buffer = model.replay_buffer
    buffer.demonstration_fraction = share
    model.learn(2 * BLOCK)
    drawn = buffer.sample_transitions(64)
    assert drawn.advised.sum() == (drawn.slot >= buffer.n_slots).sum() == expected
    # In hindsight as all others.
    if expected:
        relabelled = drawn.goal_step[drawn.advised] >= 0
        assert 0.4 < relabelled.mean() < 1.0
    assert buffer.sample(64).observations["observation"].shape == (64, 8)
    for transitions in (buffer.sample_transitions(1), buffer.sample_transitions(3)):
        assert np.isfinite(transitions.reward).all()


def test_an_empty_buffer_gives_way_to_the_other() -> None:
    env = make_vec_env(N_ENVS)
    named = {"n_envs": N_ENVS, "horizon": HORIZON, "reward_function": reward_function_of(env)}
    buffer = DemonstrationReplayBuffer(
        100, env.observation_space, env.action_space, "cpu", demonstration_size=80, **named
    )
    with pytest.raises(ValueError, match="empty"):
        buffer.sample_transitions(4)
    before: Any = env.reset()
    after, _, done, infos = env.step(np.zeros((N_ENVS, N_ARMS * ACTION), np.float32))
    step = (before, after, np.zeros((N_ENVS, N_ARMS * ACTION)), np.zeros(N_ENVS), done, infos)
    student_alone = DemonstrationReplayBuffer(
        100, env.observation_space, env.action_space, "cpu", demonstration_size=80, **named
    )
    student_alone.add(*step)
    assert (student_alone.sample_transitions(8).slot < student_alone.n_slots).all()
    buffer.demonstrations.add(*step)
    assert (buffer.sample_transitions(8).slot >= buffer.n_slots).all()
    buffer.add(*step)
    assert (buffer.sample_transitions(8).slot >= buffer.n_slots).sum() == 4
    assert (buffer.size(), buffer.demonstrations.size()) == (N_ENVS, N_ENVS)
    with pytest.raises(ValueError, match=r"demonstration_fraction=1.0: must be in \[0, 1\)"):
        DemonstrationReplayBuffer(
            100,
            env.observation_space,
            env.action_space,
            "cpu",
            demonstration_size=80,
            demonstration_fraction=1.0,
            **named,
        )


@pytest.mark.parametrize("cloning_updates", [0, 5])
def test_runs_with_demonstrations_resume(tmp_path: Path, cloning_updates: int) -> None:
    """Stopped in the middle of the demonstrations, at their end and behind it."""
    config = settings(
        advice(
            tmp_path,
            strategy="early",
            budget=4 * BLOCK,
            demonstration_steps=3 * BLOCK,
            cloning_updates=cloning_updates,
        )
    )
    assert_resumes_exactly(config, tmp_path)
    spent = [line["advice_spent"] for line in curve(tmp_path / "parts")]
    assert spent == [BLOCK, 2 * BLOCK, 3 * BLOCK, 4 * BLOCK, 4 * BLOCK, 4 * BLOCK]


@pytest.mark.parametrize("algorithm", ["td3", "sac", "tqc", "ddpg"])
def test_cloning_makes_the_student_act_as_the_teachers(tmp_path: Path, algorithm: str) -> None:
    model = demonstrated_model(tmp_path, steps=10 * BLOCK, algorithm=algorithm, total_steps=400)
    buffer = model.replay_buffer.demonstrations
    drawn = buffer.sample_transitions(300)
    drawn = replace(drawn, desired_goal=drawn.episode_goal)
    expected = np.clip(teachers_actions(model, rows_of(drawn)), -1, 1)

    def error() -> float:
        action, _ = model.predict(rows_of(drawn), deterministic=True)
        return float(np.square(model.policy.scale_action(action) - expected).mean())

    critics = [tensor.clone() for tensor in model.critic.parameters()]
    before = error()
    loss = clone(model, buffer, updates=400, batch_size=64, learning_rate=1e-3)
    assert error() < 0.1 * before
    assert loss < 0.2 * before
    for tensor, old in zip(model.critic.parameters(), critics, strict=True):
        assert tensor.equal(old)
    if algorithm == "td3":
        for name, tensor in model.actor.state_dict().items():
            assert tensor.equal(model.actor_target.state_dict()[name])
    assert model.actor.optimizer.state_dict()["state"] == {}
    assert all(one.grad is None or not one.grad.any() for one in model.actor.parameters())


def test_a_cloned_run_evaluates_the_clone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before the first gradient step of its own, the student is what was cloned."""
    given = advice(tmp_path, demonstration_steps=4 * BLOCK, budget=4 * BLOCK, cloning_updates=300)
    start(settings(given), tmp_path / "run", stop_after_steps=4 * BLOCK)
    monkeypatch.setattr(
        "saver_advisors.training.launch.build_env", lambda config: make_vec_env(config.n_envs)
    )
    student = load_trained(tmp_path / "run", "latest")
    untrained = build_model(settings(None), make_vec_env(4))
    pair = side_by_side(load_teacher(given["teacher"]), N_ARMS)
    env = make_vec_env(20)
    env.seed(0)
    seen: Any = env.reset()

    def error(model: Any) -> float:
        difference = model.predict(seen, deterministic=True)[0] - pair.predict(seen)[0]
        return float(np.abs(difference / (env.action_space.high - env.action_space.low)).mean())

    assert error(student) < 0.5 * error(untrained)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"demonstration_steps": 3 * BLOCK}, "at most advice.budget=80, which pays"),
        (
            {"demonstration_steps": 45, "budget": 79},
            r"45 are 80 in whole episodes of 4 environments \(10 steps each\), but "
            r"advice.budget=79: raise it, or ask for at most 40",
        ),
        (
            {"demonstration_steps": 7 * BLOCK, "budget": 10**6},
            r"but total_steps=240: raise it, or ask for at most 240",
        ),
        ({"arms": [0]}, r"with advice.arms=\[0\]: a demonstration needs a teacher for every arm"),
        ({"demonstration_fraction": 1.0}, r"advice.demonstration_fraction=1.0 must be in \[0, 1\)"),
        ({"demonstration_steps": 0, "cloning_updates": 5}, "nothing to clone"),
        ({"demonstration_steps": -1}, "advice.demonstration_steps=-1 must be 0 or more"),
        ({"cloning_updates": -1}, "advice.cloning_updates=-1 must be 0 or more"),
        ({"demonstration_steps": 1.5}, "advice.demonstration_steps=1.5 must be a whole number"),
    ],
)
def test_what_does_not_fit_is_refused_before_a_step(
    tmp_path: Path, more: dict[str, Any], message: str
) -> None:
    envs: list[Any] = []
    with pytest.raises((ValueError, TypeError), match=message):
        start(settings(advice(tmp_path, **more)), tmp_path / "run", envs=envs)
    assert all(steps_taken(env) == 0 for env in envs)
