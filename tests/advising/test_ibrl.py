"""The better of teacher and student, by the student's critics: in acting and in the target."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th
from stable_baselines3 import SAC, TD3
from stable_baselines3.common.vec_env import VecNormalize
from test_advised_algorithms import make_model, stored, teacher_actions
from toy_arms import ACTION, N_ARMS, make_teacher, make_vec_env
from toy_runs import (
    BLOCK,
    advisor_state,
    assert_resumes_exactly,
    replay,
    save_teacher,
    settings,
    start,
)

from saver_advisors.advising import AdvisingCallback, build_advised, make_advisor
from saver_advisors.training.building import build_model


def advice(folder: Path, **more: Any) -> dict[str, Any]:
    return {"strategy": "ibrl", "teacher": save_teacher(folder), "budget": 10**6, **more}


def least_values(model: Any, rows: dict[str, Any], actions: Any) -> Any:
    """(n, values) of actions in the environment's units."""
    tensors, _ = model.policy.obs_to_tensor(rows)
    scaled = th.as_tensor(np.asarray(model.policy.scale_action(actions), np.float32))
    with th.no_grad():
        return th.stack(model.critic(tensors, scaled)).amin(dim=0).numpy()


@pytest.mark.parametrize("normalised", [False, True])
@pytest.mark.parametrize("algorithm", [TD3, SAC])
def test_stock_algorithms_execute_what_their_critics_prefer(
    algorithm: Any, normalised: bool
) -> None:
    """Untrained critics have preferences too; without gradient steps they keep them."""
    env: Any = make_vec_env(4)
    if normalised:
        env = VecNormalize(env, norm_reward=False, training=False)
    advisor = make_advisor("ibrl", make_teacher(), 10**6, n_arms=2)
    model = make_model(algorithm, env)
    model.gradient_steps = 0
    model.learn(120, callback=AdvisingCallback(advisor))
    rows, executed = stored(model)
    by_teacher = teacher_actions(advisor, rows)
    arms = np.array(model.replay_buffer.arms)
    assert 0.1 < arms.mean() < 0.9
    assert advisor.spent == arms.any(axis=2).sum()
    replaced = np.repeat(arms, ACTION, axis=2)
    np.testing.assert_allclose(executed[replaced], by_teacher[replaced], atol=1e-5)
    flat = {key: values.reshape(120, -1) for key, values in rows.items()}
    seen = env.normalize_obs(flat) if normalised else flat
    best = least_values(model, seen, executed.reshape(120, -1))[:, 0]
    # What both arms would have got from the teacher was no better than what was done.
    both = least_values(model, seen, by_teacher.reshape(120, -1))[:, 0]
    assert (both <= best + 1e-5).all()
    alone = ~arms.reshape(120, -1).any(axis=1)
    for arm in range(N_ARMS):
        mixed = executed.reshape(120, -1).copy()
        block = slice(arm * ACTION, (arm + 1) * ACTION)
        mixed[:, block] = by_teacher.reshape(120, -1)[:, block]
        assert (least_values(model, seen, mixed)[alone, 0] <= best[alone] + 1e-5).all()


@pytest.mark.parametrize("algorithm", ["td3", "sac", "tqc", "ddpg"])
@pytest.mark.parametrize("arms", [None, [1]])
def test_every_learner_can(tmp_path: Path, algorithm: str, arms: list[int] | None) -> None:
    config = settings(advice(tmp_path, arms=arms), algorithm=algorithm, total_steps=2 * BLOCK)
    start(config, tmp_path / "run")
    state = advisor_state(tmp_path / "run")
    flags = replay(tmp_path / "run")["advised"]
    assert 0 < flags.sum() < flags.size
    assert flags.sum() == state["budget"]["spent"]
    if arms is not None:
        assert state["advised_per_arm"][0] == 0


def test_per_arm_critics_ask_their_own_value(tmp_path: Path) -> None:
    config = settings(advice(tmp_path), per_arm_critics=True, n_envs=8)
    model: Any = build_model(config, make_vec_env(8))
    model._last_obs = model.env.reset()
    executed, _ = model._sample_action(0, None, 8)
    mask = model._advice_mask
    by_teacher = model.advisor.mapping.join_actions(
        np.clip(model.advisor.teacher_actions(model._last_obs), *box(model))
    )
    # The student's own action, of which only the blocks of unadvised arms are left.
    replaced = np.repeat(mask, ACTION, axis=1)
    np.testing.assert_allclose(executed[replaced], by_teacher[replaced], atol=1e-5)
    assert 0 < mask.mean() < 1
    values = model._student_values(np.stack([executed, by_teacher]))
    assert values.shape == (2, 8, 3)


def box(model: Any) -> tuple[Any, Any]:
    mapping = model.advisor.mapping
    return mapping.split_action(model.action_space.low), mapping.split_action(
        model.action_space.high
    )


def test_it_has_to_be_told_the_students_values() -> None:
    advisor = make_advisor("ibrl", make_teacher(), 10, n_arms=2)
    rows = {
        "observation": np.zeros((1, 8), np.float32),
        "achieved_goal": np.zeros((1, 7), np.float32),
        "desired_goal": np.zeros((1, 7), np.float32),
    }
    with pytest.raises(ValueError, match="'ibrl' reads the student's critics: advise through"):
        advisor.advise(rows, np.zeros((1, 4), np.float32))


# The target --------------------------------------------------------------------------------------


@pytest.mark.parametrize("per_arm_critics", [False, True])
@pytest.mark.parametrize("arms", [None, [1]])
def test_the_target_takes_the_better_next_action(
    tmp_path: Path, per_arm_critics: bool, arms: list[int] | None
) -> None:
    config = settings(advice(tmp_path, bootstrap=True, arms=arms), per_arm_critics=per_arm_critics)
    model: Any = build_model(config, make_vec_env(4))
    model.critic_target.value_bounds = None  # untrained values lie on both sides of 0
    model.learn(BLOCK)
    batch = model.replay_buffer.sample(40)
    with th.no_grad():
        own = model.actor_target(batch.next_observations)
        chosen = model._better_actions(batch.next_observations, own)
    proposed = th.as_tensor(model.bootstrap_proposals(batch.next_observations)[0]).reshape(40, -1)
    kept = (chosen == own).reshape(40, N_ARMS, ACTION).all(dim=2)
    taken = (chosen == proposed).reshape(40, N_ARMS, ACTION).all(dim=2)
    assert (kept | taken).all()
    assert taken.any()
    if arms is not None:
        assert kept[:, 0].all()

    def least(actions: th.Tensor) -> th.Tensor:
        with th.no_grad():
            return th.stack(model.critic_target(batch.next_observations, actions)).amin(dim=0)

    if not per_arm_critics:
        assert (least(chosen) >= least(own)).all()
        assert (least(chosen) > least(own)).any()
        if arms is None:
            assert (least(chosen) >= least(proposed)).all()


def test_proposals_are_the_teachers_actions_while_the_budget_lasts(tmp_path: Path) -> None:
    config = settings(advice(tmp_path, bootstrap=True, budget=BLOCK, strategy="early"))
    model: Any = build_model(config, make_vec_env(4))
    model.num_timesteps, model.gradient_steps = 0, 0
    seen: Any = model.env.reset()
    tensors, _ = model.policy.obs_to_tensor(seen)
    expected = model.policy.scale_action(
        model.advisor.mapping.join_actions(model.advisor.teacher_actions(seen))
    )
    proposed, _ = model.bootstrap_proposals(tensors)
    np.testing.assert_allclose(
        proposed.reshape(4, -1), np.clip(expected, -1, 1), rtol=1e-5, atol=1e-6
    )
    assert model.advisor.spent == 0, "asking costs nothing"
    model.learn(BLOCK)
    assert model.bootstrap_proposals(tensors) is None
    own = th.zeros((4, N_ARMS * ACTION))
    assert model._better_actions(tensors, own) is own


def test_bootstrapping_changes_the_learning_and_resumes(tmp_path: Path) -> None:
    without = settings(advice(tmp_path, strategy="early", budget=3 * BLOCK))
    config = settings(advice(tmp_path, strategy="early", budget=3 * BLOCK, bootstrap=True))
    assert_resumes_exactly(config, tmp_path)
    start(without, tmp_path / "without")
    policies = [tmp_path / name / "latest" / "policy.safetensors" for name in ("whole", "without")]
    assert policies[0].read_bytes() != policies[1].read_bytes()


def test_ibrl_as_a_whole_resumes(tmp_path: Path) -> None:
    config = settings(advice(tmp_path, bootstrap=True, budget=2 * BLOCK), per_arm_critics=True)
    assert_resumes_exactly(config, tmp_path)


def test_saved_models_hold_no_teacher(tmp_path: Path) -> None:
    model: Any = build_model(settings(advice(tmp_path, bootstrap=True)), make_vec_env(4))
    model.save(tmp_path / "model.zip")
    loaded: Any = build_advised(type(model)).load(tmp_path / "model.zip", env=make_vec_env(4))
    assert loaded.bootstrap_proposals is None
    assert loaded.advisor is None


def test_other_algorithms_cannot_bootstrap(tmp_path: Path) -> None:
    for algorithm in ("sac", "tqc", "ddpg"):
        with pytest.raises(ValueError, match=r"advice.bootstrap=True needs algorithm='td3', not"):
            settings(advice(tmp_path, bootstrap=True), algorithm=algorithm)
