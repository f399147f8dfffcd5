"""RL Zoo's experiment manager with batched environments, and models chosen by success."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from rl_zoo3.exp_manager import ExperimentManager
from rl_zoo3.utils import get_class_by_name
from stable_baselines3.common.callbacks import EvalCallback
from stable_baselines3.common.vec_env import VecEnv

from saver_advisors.reporting.errors import user_mistakes
from saver_advisors.zoo.algorithms import register_algorithms
from saver_advisors.zoo.vec_env import BatchedVecEnv


class SuccessEvalCallback(EvalCallback):
    """Keeps the model with the highest success rate, and of equals the later one.

    SB3's keeps the highest mean reward, which with a reward of -1 and 0 prefers a policy that is
    fast where it succeeds to one that succeeds more often. Environments without ``is_success``
    are left to SB3's rule.

    :param arguments: as for `EvalCallback`
    """

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.best_success_rate = -np.inf

    def _on_step(self) -> bool:
        evaluates = self.eval_freq > 0 and self.n_calls % self.eval_freq == 0
        if not evaluates:
            return True
        folder, on_new_best = self.best_model_save_path, self.callback_on_new_best
        self.best_model_save_path = self.callback_on_new_best = None
        rewarded = self.best_mean_reward
        try:
            goes_on = super()._on_step()
        finally:
            self.best_model_save_path, self.callback_on_new_best = folder, on_new_best
        if self._is_success_buffer:
            success_rate = float(np.mean(self._is_success_buffer))
            best = success_rate >= self.best_success_rate
            self.best_success_rate = max(success_rate, self.best_success_rate)
        else:
            best = self.best_mean_reward > rewarded
        if best and folder is not None:
            self.model.save(Path(folder) / "best_model")
        if best and on_new_best is not None:
            goes_on = on_new_best.on_step() and goes_on
        return goes_on


class SaverExperimentManager(ExperimentManager):
    """RL Zoo's manager whose evaluations keep the model that succeeds most often.

    A settings file may name a replay buffer by module and class; RL Zoo itself evaluates the text
    as Python, among the names that it has imported.
    """

    def setup_experiment(self) -> Any:
        """As RL Zoo's; what environment or algorithm refuse of the settings is the user's mistake.

        :raises UsageError: telling what they said
        """
        with user_mistakes():
            return super().setup_experiment()

    def _preprocess_hyperparams(self, hyperparams: dict[str, Any]) -> Any:
        buffer = hyperparams.get("replay_buffer_class")
        if isinstance(buffer, str) and "." in buffer:
            try:
                hyperparams["replay_buffer_class"] = get_class_by_name(buffer)
            except (ImportError, AttributeError) as error:
                raise ValueError(f"replay_buffer_class={buffer!r} is no class: {error}") from error
        return super()._preprocess_hyperparams(hyperparams)

    def create_callbacks(self) -> None:
        """As RL Zoo's, with `SuccessEvalCallback` in place of `EvalCallback`."""
        super().create_callbacks()  # type: ignore[no-untyped-call]
        self.callbacks = [
            self._by_success(one) if type(one) is EvalCallback else one for one in self.callbacks
        ]

    def _by_success(self, callback: EvalCallback) -> SuccessEvalCallback:
        return SuccessEvalCallback(
            callback.eval_env,
            callback_on_new_best=callback.callback_on_new_best,
            best_model_save_path=callback.best_model_save_path,
            n_eval_episodes=callback.n_eval_episodes,
            log_path=self.save_path,
            eval_freq=callback.eval_freq,
            deterministic=callback.deterministic,
        )


def train(arguments: Sequence[str], vec_env_class: type[VecEnv] | None = BatchedVecEnv) -> None:
    """Call `rl_zoo3.train.train` with our algorithms, environments and manager.

    :param arguments: RL Zoo's own
    :param vec_env_class: in place of that of RL Zoo's `--vec-env`; that one where None
    """
    register_algorithms()

    class Manager(SaverExperimentManager):
        """The seam is an attribute of the class, so each call has a class of its own."""

        default_vec_env_cls = vec_env_class

    program: Any = importlib.import_module("rl_zoo3.train")
    before = program.ExperimentManager
    program.ExperimentManager = Manager
    try:
        call(program.train, arguments)
    finally:
        program.ExperimentManager = before


def enjoy(arguments: Sequence[str]) -> None:
    """Call `rl_zoo3.enjoy.enjoy` with our algorithms.

    :param arguments: RL Zoo's own
    """
    from rl_zoo3.enjoy import enjoy as play

    register_algorithms()
    call(play, arguments)


def call(program: Callable[[], object], arguments: Sequence[str]) -> None:
    """Run a program that reads the command line of the process.

    :param program: the function
    :param arguments: what it shall read there
    """
    with _command_line(["rl_zoo3", "--gym-packages", "saver_envs", *arguments]):
        program()


@contextmanager
def _command_line(words: list[str]) -> Iterator[None]:
    before, sys.argv = sys.argv, words
    try:
        yield
    finally:
        sys.argv = before
