"""A vector env whose episodes start from the protocol's seeds, whichever seeds it is given."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from gymnasium.utils import seeding
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from saver_advisors.evaluation.protocol import MAX_RUN_SEED, SELECTION_SEEDS, training_seed
from saver_envs.envs.sb3_vec_env import SaverVecEnv


class ProtocolVecEnv(VecEnvWrapper):
    """Let other libraries train and evaluate on the seeds of the protocol.

    They pass the run's own seed to the environments of training and of evaluation, and then start
    from the same episodes. Here a run's seed selects the training seeds that belong to it, and each
    reset for an evaluation starts again with the first selection seed. In our own vector env all
    episodes of an evaluation have consecutive seeds, in others only the first of each environment.

    :param venv: the environments.
    :param seed: of the run.
    :param selection: whether they are for evaluations.
    """

    def __init__(self, venv: VecEnv, seed: int, *, selection: bool = False) -> None:
        super().__init__(venv)
        self._run_seed = seed
        self._selection = selection
        self.seed(seed)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed the next reset for a run.

        :param seed: of the run; None for the one given at construction.
        :return: the seed of each environment.
        """
        if self._selection:
            return self.venv.seed(SELECTION_SEEDS[0])
        # RL Zoo draws seeds of up to 32 bits.
        chosen = self._run_seed if seed is None else seed
        return self.venv.seed(training_seed(chosen % (MAX_RUN_SEED + 1)))

    def reset(self) -> VecEnvObs:
        """Start all episodes."""
        if self._selection:
            self.seed()
        observation = self.venv.reset()
        self._drawn = self.num_envs
        self._seed_following(np.ones(self.num_envs, bool))
        return observation

    def step_wait(self) -> VecEnvStepReturn:
        """Wait for the step; episodes that end are reset at once."""
        result = self.venv.step_wait()
        self._seed_following(result[2])
        return result

    def _seed_following(self, started: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> None:
        """Seed the episodes that follow those that have just started: starts are drawn at once."""
        inner = self.unwrapped
        if self._selection and isinstance(inner, SaverVecEnv):
            for index in np.flatnonzero(started):
                seed = SELECTION_SEEDS[self._drawn % len(SELECTION_SEEDS)]
                inner.episodes.set_generator(int(index), seeding.np_random(seed)[0])
                self._drawn += 1
