"""RL Zoo's experiment manager with batched environments, and models selected by success."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from rl_zoo3.exp_manager import ExperimentManager
from rl_zoo3.utils import get_class_by_name
from stable_baselines3.common.callbacks import EvalCallback
from stable_baselines3.common.vec_env import VecEnv

from saver_advisors.evaluation.protocol_env import ProtocolVecEnv
from saver_advisors.reporting.errors import user_mistakes
from saver_advisors.zoo.algorithms import register_algorithms
from saver_advisors.zoo.vec_env import BatchedVecEnv


class SuccessEvalCallback(EvalCallback):
    """Keep the model with the highest success rate, the later of equals.

    SB3's callback keeps the one with the highest mean reward. With rewards of -1 and 0 that
    prefers a policy that succeeds fast to one that succeeds more often. For environments without
    ``is_success`` SB3's rule remains.
    """

    best_success_rate = -np.inf

    def _on_step(self) -> bool:
        if self.eval_freq <= 0 or self.n_calls % self.eval_freq:
            return True
        folder, on_new_best = self.best_model_save_path, self.callback_on_new_best
        self.best_model_save_path = self.callback_on_new_best = None
        rewarded = self.best_mean_reward
        try:
            proceed = super()._on_step()
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
            proceed = on_new_best.on_step() and proceed
        return proceed


class SaverExperimentManager(ExperimentManager):
    """RL Zoo's manager with the protocol's seeds, keeping the model that succeeds most often.

    A settings file may name a replay buffer by module and class. RL Zoo evaluates the text as
    Python, with the names that it has imported.
    """

    def setup_experiment(self) -> Any:
        """Build environment and model; see RL Zoo.

        :raises UsageError: for settings that environment or algorithm reject.
        """
        with user_mistakes():
            return super().setup_experiment()

    def create_envs(self, n_envs: int, eval_env: bool = False, no_log: bool = False) -> VecEnv:
        """Create RL Zoo's environments, for training or for evaluation; see `ProtocolVecEnv`.

        :param n_envs: their number.
        :param eval_env: whether they are for evaluations.
        :param no_log: whether not to write RL Zoo's monitor file.
        """
        venv = super().create_envs(n_envs, eval_env, no_log)
        return ProtocolVecEnv(venv, self.seed, selection=eval_env)

    def _preprocess_hyperparams(self, hyperparams: dict[str, Any]) -> Any:
        buffer = hyperparams.get("replay_buffer_class")
        if isinstance(buffer, str) and "." in buffer:
            try:
                hyperparams["replay_buffer_class"] = get_class_by_name(buffer)
            except (ImportError, AttributeError) as error:
                raise ValueError(f"replay_buffer_class={buffer!r} is unknown: {error}") from error
        return super()._preprocess_hyperparams(hyperparams)

    def create_callbacks(self) -> None:
        """Create RL Zoo's callbacks, with `SuccessEvalCallback` in place of `EvalCallback`."""
        super().create_callbacks()  # type: ignore[no-untyped-call]
        for callback in self.callbacks:
            if type(callback) is EvalCallback:
                # It keeps its settings; only its rule for the best model changes.
                callback.__class__ = SuccessEvalCallback


def train(arguments: Sequence[str]) -> None:
    """Run `rl_zoo3.train` with our algorithms, batched environments and manager.

    :param arguments: RL Zoo's arguments; with `--vec-env` the environments are that one's.
    """
    register_algorithms()
    chosen = any(word.split("=")[0] == "--vec-env" for word in arguments)

    class Manager(SaverExperimentManager):
        """A class per call, because RL Zoo reads the environments' class from it."""

        default_vec_env_cls = None if chosen else BatchedVecEnv

    program: Any = importlib.import_module("rl_zoo3.train")
    before = program.ExperimentManager
    program.ExperimentManager = Manager
    try:
        with _command_line(arguments):
            program.train()
    finally:
        program.ExperimentManager = before


def enjoy(arguments: Sequence[str]) -> None:
    """Run `rl_zoo3.enjoy` with our algorithms.

    :param arguments: RL Zoo's arguments.
    """
    from rl_zoo3.enjoy import enjoy as play

    register_algorithms()
    with _command_line(arguments):
        play()


@contextmanager
def _command_line(arguments: Sequence[str]) -> Iterator[None]:
    """Replace the process's command line, which RL Zoo's programs read."""
    before, sys.argv = sys.argv, ["rl_zoo3", "--gym-packages", "saver_envs", *arguments]
    try:
        yield
    finally:
        sys.argv = before
