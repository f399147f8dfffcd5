"""Time replay and advice."""

from __future__ import annotations

import time
from statistics import median
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from saver_advisors.benchmark.machine import cores, timed
from saver_advisors.benchmark.speed.steps import SPARE
from saver_envs.registration import TWO_ARM_ID

#: Replay: number of stored transitions, and batch size.
REPLAY_ROWS, REPLAY_BATCH = 200_000, 256
#: Advice: number of environments, and timed strategies.
N_ENVS: Final = 16
ADVICE: Final = ("early", "mc-q")
TEACHER: Final = "jaco-push"


def replay_row(rounds: int) -> dict[str, Any]:
    """Time relabelled sampling from a full buffer.

    :param rounds: a twentieth of the number of draws
    :return: ``rows``, ``batch`` and ``milliseconds``
    """
    from saver_advisors.learner.replay import GoalReplayBuffer
    from saver_envs.envs.spaces import action_space, observation_space
    from saver_envs.registration import make_episodes

    episodes = make_episodes(TWO_ARM_ID)
    horizon, n_envs = episodes.settings.horizon, N_ENVS
    buffer = GoalReplayBuffer(
        REPLAY_ROWS,
        observation_space(episodes),
        action_space(episodes),
        device="cpu",
        n_envs=n_envs,
        horizon=horizon,
        reward_function=episodes.task.reward,
        seed=0,
    )
    random = np.random.default_rng(0)

    def seen() -> dict[str, NDArray[Any]]:
        sizes = {"observation": episodes.observation_size, "achieved_goal": episodes.goal_size}
        return {k: random.normal(size=(n_envs, v)).astype(np.float32) for k, v in sizes.items()}

    infos: list[dict[str, Any]] = [{} for _ in range(n_envs)]
    while not buffer.full:
        goal = random.normal(size=(n_envs, episodes.goal_size))
        before = {**seen(), "desired_goal": goal}
        for step in range(horizon):
            after = {**seen(), "desired_goal": goal}
            action = random.uniform(-1, 1, (n_envs, episodes.action_size))
            done = np.full(n_envs, step == horizon - 1)
            buffer.add(before, after, action, np.zeros(n_envs), done, infos)
            before = after
    with cores(1):
        times = [timed(lambda: buffer.sample(REPLAY_BATCH)) for _ in range(20 * rounds)]
    return {"rows": buffer.size(), "batch": REPLAY_BATCH, "milliseconds": median(times) * 1e3}


def advice_row(strategy: str, rounds: int, seconds: float) -> dict[str, Any]:
    """Time the advice to two arms of each environment, and the step itself.

    :param strategy: name of an advising strategy
    :param rounds: number of rounds
    :param seconds: approximate duration of a round
    :return: ``strategy``, ``n_envs``, ``arms``, ``milliseconds`` and ``share_of_step``
    """
    from saver_advisors.advising import make_advisor
    from saver_envs.envs.sb3_vec_env import SaverVecEnv

    with cores(1):
        env = SaverVecEnv(TWO_ARM_ID, N_ENVS, seed=0)
        arms = env.episodes.task.n_arms
        advisor = make_advisor(strategy, TEACHER, 10**9, n_arms=arms)
        size = (N_ENVS, env.episodes.action_size)
        action = np.random.default_rng(0).uniform(-1, 1, size).astype(np.float32)
        advised, stepped = [], []
        for _ in range(rounds):
            observation = env.reset()
            advisor.advise(observation, action)
            repeats = max(1, round(seconds / 0.02))
            for _ in range(min(repeats, env.episodes.settings.horizon - SPARE)):
                began = time.perf_counter()
                advisor.advise(observation, action)
                between = time.perf_counter()
                env.step(action)
                advised.append(between - began)
                stepped.append(time.perf_counter() - between)
                observation = env.episodes.observation().as_dict()
    return {
        "strategy": strategy,
        "env": TWO_ARM_ID,
        "n_envs": N_ENVS,
        "arms": arms,
        "milliseconds": median(advised) * 1e3,
        "share_of_step": median(advised) / median(stepped),
    }
