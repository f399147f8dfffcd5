"""Independent learners: one unchanged Stable-Baselines3 model for each agent (Tan 1993).

Each model's ``learn`` runs in a thread of its own, in an environment that shows it one agent. When
it has acted, it waits for the others, and the last one steps the common environments. One thread
runs at a time, in the order of the agents, so that runs with the same seeds are equal.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from threading import Semaphore
from typing import Any

import numpy as np
import numpy.typing as npt
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper

from saver_envs.envs.agents_vec_env import AgentsVecEnv, Stepped


class LearnersOutOfStep(RuntimeError):
    """Raised in a learner that cannot continue, since another one has failed or ended."""


class IndependentLearners:
    """A model for each agent; all of them learn at once from common episodes.

    :param env: the environments of all agents.
    :param build: agent and its environment -> its model. All models need the same ``train_freq`` or
        ``n_steps``; seeds that differ, for exploration that differs; and policies and buffers of
        their own. Their seeds do not change those of the environments.
    """

    def __init__(self, env: AgentsVecEnv, build: Callable[[str, VecEnv], BaseAlgorithm]) -> None:
        self.env = env
        self._turns = Turns(len(env.agents), self._together)
        self.models = {agent: build(agent, self._env_of(agent)) for agent in env.agents}

    def _env_of(self, agent: str) -> AgentVecEnv:
        return AgentVecEnv(self.env, agent, self._turns)

    def learn(
        self, total_timesteps: int, callbacks: Mapping[str, Any] | None = None, **arguments: Any
    ) -> None:
        """Call every model's ``learn``.

        :param total_timesteps: of each agent, summed over environments.
        :param callbacks: agent -> its ``callback``.
        :param arguments: as for SB3's ``learn``, the same for all models.
        :raises LearnersOutOfStep: if the models take different numbers of steps.
        """
        callbacks = callbacks or {}

        def job(agent: str, model: BaseAlgorithm) -> Callable[[], Any]:
            return lambda: model.learn(total_timesteps, callbacks.get(agent), **arguments)

        self._turns.run([job(*one) for one in self.models.items()])

    def _together(self, given: Sequence[npt.NDArray[Any] | None]) -> Any:
        """Step the environments with every agent's actions, or reset them if none has any."""
        if all(actions is None for actions in given):
            return self.env.reset()
        actions = np.zeros((self.env.num_envs, *(self.env.action_space.shape or ())), np.float32)
        for agent, own in zip(self.env.agents, given, strict=True):
            if own is None:
                raise LearnersOutOfStep(f"{agent} resets its episodes while others step theirs")
            actions[self.env.rows_of(agent)] = own
        return self.env.step(actions)


class AgentVecEnv(VecEnvWrapper):
    """The environments as one agent sees them; for use by :class:`IndependentLearners`.

    Attributes are those of the common environments.

    :param env: the environments of all agents.
    :param agent: its name.
    :param turns: of the agents' threads.
    """

    _actions: npt.NDArray[Any]

    def __init__(self, env: AgentsVecEnv, agent: str, turns: Turns) -> None:
        super().__init__(env)
        self.num_envs = len(env.envs)
        self._rows = env.rows_of(agent)
        self._index, self._turns = env.agents.index(agent), turns

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Leave the seeds as they are: those of common environments are no single agent's."""
        return [None] * self.num_envs

    def reset(self) -> Any:
        """Start all episodes, with the other agents."""
        seen = self._turns.meet(self._index, None)
        self.reset_infos = self.venv.reset_infos[self._rows]
        return self._own(seen)

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Keep the actions (environments, action_size) for :meth:`step_wait`."""
        self._actions = actions

    def step_wait(self) -> Stepped:
        """Step all episodes, with the other agents."""
        seen, rewards, dones, infos = self._turns.meet(self._index, self._actions)
        return self._own(seen), rewards[self._rows], dones[self._rows], infos[self._rows]

    def _own(self, seen: Any) -> Any:
        if isinstance(seen, dict):
            return {name: rows[self._rows] for name, rows in seen.items()}
        return seen[self._rows]


class Turns:
    """Let n threads run one at a time, in order, each until it meets the others.

    :param n: number of threads.
    :param together: called where they meet, with what each of them has given.
    """

    def __init__(self, n: int, together: Callable[[Sequence[Any]], Any]) -> None:
        self._n, self._together = n, together
        self._begin()

    def _begin(self) -> None:
        self._given: list[Any] = [None] * self._n
        self._result: Any = None
        self._meetings = 0
        self._ended = False
        self._may_run = [Semaphore(0) for _ in range(self._n)]

    def run(self, functions: Sequence[Callable[[], Any]]) -> None:
        """Call functions in threads, and raise the error of one that fails.

        :param functions: (n,).
        """
        self._begin()
        self._may_run[0].release()
        with ThreadPoolExecutor(self._n) as pool:
            jobs = [pool.submit(self._in_turn, *one) for one in enumerate(functions)]
            try:
                wait(jobs)
            finally:
                self._ended = True  # after Ctrl-C, they stop where they meet
        errors = [error for job in jobs if (error := job.exception()) is not None]
        # One that fails stops the others.
        for error in sorted(errors, key=lambda one: isinstance(one, LearnersOutOfStep)):
            raise error

    def _in_turn(self, index: int, function: Callable[[], Any]) -> None:
        self._may_run[index].acquire()
        try:
            function()
        finally:
            self._ended = True
            self._pass_on(index)

    def meet(self, index: int, given: Any) -> Any:
        """Wait for the other threads.

        :param index: of the calling thread.
        :param given: what it has for ``together``.
        :return: the result of ``together``, the same object for all.
        :raises LearnersOutOfStep: if another thread does not come.
        """
        met = self._meetings
        if not self._ended:
            self._given[index] = given
            if index == self._n - 1:
                self._result = self._together(self._given)
                self._meetings += 1
            self._pass_on(index)
            self._may_run[index].acquire()
        if self._meetings == met:
            raise LearnersOutOfStep(
                "another agent's learner has failed or ended: all need the same number of steps "
                "between updates (`train_freq` or `n_steps`)"
            )
        return self._result

    def _pass_on(self, index: int) -> None:
        self._may_run[(index + 1) % self._n].release()
