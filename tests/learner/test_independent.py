"""Independent learners: each model learns from its own agent, all from the same episodes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch as th
from counting_agents import Counting
from stable_baselines3 import A2C
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

from saver_advisors.learner.independent import IndependentLearners, LearnersOutOfStep
from saver_envs.envs.agents_vec_env import AgentsVecEnv

AGENTS = ("left", "right")


class Recorder(BaseCallback):
    """Keep what a model did and saw."""

    def __init__(self) -> None:
        super().__init__()
        self.steps: list[tuple[Any, ...]] = []

    def _on_step(self) -> bool:
        names = "clipped_actions", "new_obs", "rewards", "infos"
        self.steps.append(tuple(np.copy(self.locals[name]) for name in names))
        return True


def learners(n_steps: tuple[int, int] = (4, 4), m: int = 3) -> IndependentLearners:
    env = AgentsVecEnv([lambda: Counting(lengths=(100, 100))] * m, seed=0)

    def build(agent: str, own: VecEnv) -> A2C:
        index = AGENTS.index(agent)
        return A2C("MlpPolicy", own, n_steps=n_steps[index], seed=index, device="cpu")

    return IndependentLearners(env, build)


def parameters(of: IndependentLearners) -> th.Tensor:
    every = [one for model in of.models.values() for one in model.policy.parameters()]
    return th.cat([one.detach().flatten() for one in every])


def test_each_model_acts_and_learns_for_its_agent_alone() -> None:
    both, recorders = learners(), {agent: Recorder() for agent in AGENTS}
    before = parameters(both)
    both.learn(36, recorders)
    assert (parameters(both) != before).any()
    acted = {}
    for agent, recorder in recorders.items():
        actions, seen, rewards, infos = zip(*recorder.steps, strict=True)
        assert len(actions) == 12 == both.models[agent].num_timesteps // 3
        np.testing.assert_allclose(seen, np.cumsum(actions, axis=0), rtol=1e-5)
        np.testing.assert_array_equal(rewards, np.array(actions)[..., 0])
        assert {info["of"] for step in infos for info in step} == {agent}
        acted[agent] = np.array(actions)
    assert not np.allclose(*acted.values())
    assert [one.seeds for one in both.env.envs] == [[0], [1], [2]]


def test_runs_are_repeatable_and_continue_in_the_same_episodes() -> None:
    runs = []
    for _ in range(2):
        first = learners()  # SB3 seeds torch's generator when a model is built
        first.learn(24)
        runs.append(parameters(first))
    assert th.equal(*runs)
    first.learn(24, reset_num_timesteps=False)
    assert [one.clock for one in first.env.envs] == [16] * 3
    assert [model.num_timesteps for model in first.models.values()] == [48, 48]


@pytest.mark.parametrize("n_steps", [(4, 5), (5, 4)])
def test_learners_of_different_blocks_are_refused(n_steps: tuple[int, int]) -> None:
    with pytest.raises(LearnersOutOfStep, match="the same number of steps"):
        learners(n_steps).learn(12 * 3)


@pytest.mark.parametrize("agent", AGENTS)
def test_the_error_of_one_stops_all_and_is_raised(agent: str) -> None:
    class Broken(Recorder):
        def _on_step(self) -> bool:
            if len(self.steps) == 3:
                raise ZeroDivisionError
            return super()._on_step()

    both = learners()
    with pytest.raises(ZeroDivisionError):
        both.learn(36, {agent: Broken()})
    both.learn(36)
    assert [model.num_timesteps for model in both.models.values()] == [36, 36]
