"""The batch in place of single environments: the same episodes, the same monitor file."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import TransformReward
from rl_zoo3.wrappers import ActionNoiseWrapper
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecMonitor, is_vecenv_wrapped

import saver_envs  # noqa: F401
from saver_advisors.zoo.vec_env import BatchedVecEnv

OPTIONS: dict[str, Any] = {"max_episode_steps": 8, "object_mass": 0.4}


def make(vec_env_class: type[VecEnv], folder: Path | None, **more: Any) -> VecEnv:
    """As RL Zoo makes one."""
    spec = gymnasium.spec("DualJacoPush-v0")
    return make_vec_env(
        lambda **kwargs: spec.make(**kwargs),
        n_envs=3,
        seed=7,
        env_kwargs=OPTIONS,
        monitor_dir=None if folder is None else str(folder),
        monitor_kwargs={"info_keywords": ("is_success",)},
        vec_env_cls=vec_env_class,
        **more,
    )


def test_episodes_are_those_of_single_environments(tmp_path: Path) -> None:
    single, batched = make(DummyVecEnv, tmp_path / "one"), make(BatchedVecEnv, tmp_path / "two")
    random = np.random.default_rng(0)
    first, second = single.reset(), batched.reset()
    for _ in range(20):
        for key in first:
            np.testing.assert_array_equal(first[key], second[key])
        action = random.uniform(-1, 1, (3, 6)).astype(np.float32)
        first, reward, done, infos = single.step(action)
        second, batched_reward, batched_done, batched_infos = batched.step(action)
        np.testing.assert_array_equal(reward, batched_reward)
        np.testing.assert_array_equal(done, batched_done)
        for one, other in zip(infos, batched_infos, strict=True):
            assert set(one) == set(other) | {"TimeLimit.truncated"}  # here at the end alone
            assert one["is_success"] == other["is_success"]
            assert one["TimeLimit.truncated"] == other.get("TimeLimit.truncated", False)
            if "episode" in one:
                assert one["episode"]["l"] == other["episode"]["l"] == 8
                assert one["episode"]["r"] == pytest.approx(other["episode"]["r"])
    single.close()
    batched.close()
    returns = [sorted(returns_in(tmp_path / name)) for name in ("one", "two")]
    assert len(returns[0]) == 6
    assert returns[0] == pytest.approx(returns[1])


def returns_in(folder: Path) -> list[float]:
    """What SB3's tools would plot of the monitor files in a folder."""
    found = []
    for path in folder.glob("*.monitor.csv"):
        with path.open() as file:
            next(file)
            found += [float(row["r"]) for row in csv.DictReader(file)]
    return found


def test_one_monitor_file_is_written_and_none_without_a_folder(tmp_path: Path) -> None:
    env = make(BatchedVecEnv, tmp_path)
    assert is_vecenv_wrapped(env, VecMonitor)
    env.close()
    (path,) = tmp_path.iterdir()
    assert path.name == "0.monitor.csv"
    with path.open() as file:
        assert next(file).startswith("#")
        assert next(csv.reader(file)) == ["r", "l", "t", "is_success"]
    make(BatchedVecEnv, None).close()


@pytest.mark.parametrize(
    ("wrapper", "name"),
    [
        (lambda env: TransformReward(env, lambda reward: 2 * reward), "TransformReward"),
        (ActionNoiseWrapper, "ActionNoiseWrapper"),
    ],
)
def test_a_wrapper_that_would_be_lost_is_refused(wrapper: Any, name: str) -> None:
    with pytest.raises(ValueError, match=f"{name} wraps a single environment.*--vec-env dummy"):
        make(BatchedVecEnv, None, wrapper_class=wrapper)


def test_a_foreign_environment_is_refused() -> None:
    with pytest.raises(ValueError, match="not an environment of saver_envs"):
        BatchedVecEnv([lambda: gymnasium.make("Pendulum-v1").unwrapped])
