"""Constructors, actions and goals: accepted and sound, or refused by name."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from fuzzing import ODD, ODD_ARRAYS, cases, refusal
from hypothesis import given
from hypothesis import strategies as st

import saver_envs  # noqa: F401
from saver_envs.envs.vector_env import SaverVectorEnv
from saver_envs.registration import ENVIRONMENTS, default_options

IDS = sorted(name for name in ENVIRONMENTS if "Dense" not in name)
#: Arguments of `gymnasium.make` besides the options of an id.
OTHERS = ("render_mode", "camera", "width", "height", "not_an_option")
KINDS = (ValueError, TypeError, gymnasium.error.Error)


@cases(2.0)
@given(st.sampled_from(IDS), st.data())
def test_constructors(env_id: str, data: st.DataObject) -> None:
    names = data.draw(
        st.lists(
            st.sampled_from([*default_options(env_id), *OTHERS]),
            min_size=1,
            max_size=3,
            unique=True,
        )
    )
    # Gymnasium's own `make` fails on a mode that is no text.
    kinds = {"render_mode": st.none() | st.text(max_size=8)}
    options = {name: data.draw(kinds.get(name, ODD), label=name) for name in names}
    env, message = refusal("constructors", lambda: gymnasium.make(env_id, **options), *KINDS)
    if env is None:
        assert any(name in message for name in names), message
        return
    seen, _ = env.reset(seed=0)
    assert env.observation_space.contains(seen)
    seen, reward, _, _, _ = env.step(env.action_space.sample() * 0)
    assert env.observation_space.contains(seen)
    assert np.isfinite(reward)
    env.close()


@pytest.fixture(scope="module")
def env() -> Any:
    made = gymnasium.make("DualJacoPush-v0").unwrapped
    made.reset(seed=0)
    return made


@pytest.fixture(scope="module")
def vector_env() -> Any:
    made = SaverVectorEnv("JacoPickAndPlace-v0", num_envs=2)
    made.reset(seed=0)
    return made


def acted(env: Any, action: Any, shape: tuple[int, ...]) -> None:
    outcome, message = refusal("actions", lambda: env.step(action), ValueError, TypeError)
    if outcome is None:
        assert "action" in message, message
        return
    values = np.asarray(action)
    assert values.shape == shape
    assert values.dtype.kind in "fiub"
    assert np.isfinite(values).all()
    for part in outcome[0].values():
        assert np.isfinite(part).all()


#: Arrays of the right shape with values that are not.
WILD = st.floats(allow_nan=True, allow_infinity=True, width=64)


@cases(2.0)
@given(action=st.one_of(ODD, ODD_ARRAYS, st.lists(WILD, min_size=6, max_size=6)))
def test_actions(env: Any, action: Any) -> None:
    acted(env, action, (6,))


@cases()
@given(
    actions=st.one_of(
        ODD, ODD_ARRAYS, st.lists(st.lists(WILD, min_size=4, max_size=4), min_size=2, max_size=2)
    )
)
def test_actions_of_a_vector(vector_env: Any, actions: Any) -> None:
    acted(vector_env, actions, (2, 4))


@cases(2.0)
@given(data=st.data())
def test_goals(env: Any, data: st.DataObject) -> None:
    """Rewards of goals: of the goals' leading shape and finite, or refused."""
    right = st.lists(WILD, min_size=6, max_size=6).map(np.array)
    goals = st.one_of(right, right, ODD_ARRAYS, ODD)
    achieved, desired = data.draw(goals), data.draw(goals)
    reward, message = refusal(
        "goals", lambda: env.compute_reward(achieved, desired, {}), ValueError, TypeError
    )
    if message:
        assert "goal" in message, message
        return
    assert np.shape(achieved)[-1] == np.shape(desired)[-1] == 6
    assert np.shape(reward) == np.shape(achieved)[:-1]
    finite = (
        np.isfinite(np.asarray(achieved, float)).all()
        and np.isfinite(np.asarray(desired, float)).all()
    )
    assert np.isfinite(reward).all() or not finite
