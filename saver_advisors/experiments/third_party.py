"""Train third-party algorithms by the protocol: load by name, count steps, enforce the budget.

An algorithm is either a subclass of Stable-Baselines3's ``BaseAlgorithm``, which is built with
``MultiInputPolicy`` and a vector environment and observed through a callback, or a class with the
methods ``__init__(env, *, seed, **kwargs)``, ``learn(steps)`` and ``predict(observation)`` that
docs/benchmark-protocol.md describes, and optionally torch's ``state_dict`` and ``load_state_dict``.
"""

from __future__ import annotations

import contextlib
import copy
import hashlib
import importlib
import importlib.util
import inspect
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from numpy.typing import NDArray

from saver_advisors.evaluation.protocol import training_seed
from saver_advisors.experiments.recorder import Recorder

IMPORTED: Final = "import:"
"""Prefix of keyword arguments that name a class or a function."""

NOISE: Final = "noise_std"
"""Keyword argument for the standard deviation of SB3's action noise, as in RL Zoo."""


class BudgetSpent(Exception):
    """Signal that all environment steps of the run are done."""


class AlgorithmError(Exception):
    """Report an algorithm that cannot be built, or lacks a required method."""


class CountedVectorEnv(VectorWrapper):
    """Count steps, enforce the budget, and map seeds to those of training.

    :param env: with automatic reset at the next step, in the same step, or without
    :param recorder: of the run
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], recorder: Recorder) -> None:
        super().__init__(env)
        self._recorder = recorder
        self._begun = False
        self._over = np.zeros(env.num_envs, bool)
        mode = env.metadata["autoreset_mode"]
        self._resets_at_next_step = mode is AutoresetMode.NEXT_STEP

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environment with training seeds.

        :param seed: a number, one per environment, or None; None means the run's seed at the first
            reset
        :param options: of the environment
        """
        if seed is None and not self._begun:
            seed = self._recorder.plan.seed
        if isinstance(seed, int | np.integer):
            seed = training_seed(int(seed))
        elif seed is not None:
            seed = [None if one is None else training_seed(one) for one in seed]
        self._begun = True
        self._over[:] = False
        return self.env.reset(seed=seed, options=options)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step the environment; steps that only reset an episode do not count.

        :raises BudgetSpent: if all steps of the run are done
        """
        if self._recorder.spent:
            raise BudgetSpent(f"all {self._recorder.plan.total_steps} environment steps are done")
        result = self.env.step(actions)
        _, _, terminated, truncated, infos = result
        counted, cost = self.num_envs, self._cost_of(infos, terminated | truncated)
        if self._resets_at_next_step:
            counted -= int(self._over.sum())
            self._over = np.asarray(terminated | truncated)
        self._recorder.advance(counted, cost)
        return result

    def _cost_of(self, infos: Mapping[str, Any], ended: NDArray[np.bool_]) -> float:
        """Sum ``cost`` over the episodes that were stepped; what a reset reports is no cost."""
        costs = np.broadcast_to(infos.get("cost", 0.0), self.num_envs)
        if "final_info" in infos:
            costs = np.where(ended, infos["final_info"].get("cost", 0.0), costs)
        return float(costs[~self._over].sum())


def load_class(word: str) -> type[Any]:
    """Load the class with the name ``MODULE:CLASS`` or ``FILE.py:CLASS``.

    :param word: the name; modules in the current folder are found
    :return: the class, or another callable that returns an algorithm
    :raises ValueError: for another form, or a name of nothing callable
    """
    found = load_object(word)
    if not callable(found):
        raise ValueError(f"{word!r} is not a class: it cannot be called")
    return cast("type[Any]", found)


def load_object(word: str) -> Any:
    """Load the object with the name ``MODULE:NAME`` or ``FILE.py:NAME``.

    :param word: the name
    :raises ValueError: for another form, or an unknown name
    """
    module_name, colon, name = word.rpartition(":")
    if not colon or not module_name or not name:
        raise ValueError(f"{word!r} must have the form MODULE:CLASS or FILE.py:CLASS")
    try:
        module = _module_of(module_name)
    except ImportError as error:
        raise ValueError(f"{module_name!r} cannot be imported: {error}") from error
    if not hasattr(module, name):
        public = [key for key, value in vars(module).items() if inspect.isclass(value)]
        raise ValueError(f"{module_name!r} has no {name!r}; its classes are {', '.join(public)}")
    return getattr(module, name)


def _module_of(name: str) -> Any:
    """Import a module by its name or its file."""
    if not name.endswith(".py"):
        if (here := os.getcwd()) not in sys.path:
            sys.path.append(here)  # last: a file of the folder hides no installed package
        return importlib.import_module(name)
    path = Path(name)
    if not path.is_file():
        raise ValueError(f"the file {name!r} does not exist")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None  # the name ends in .py
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module


def file_sha256(word: str) -> str | None:
    """Return the digest of the file that an algorithm's name contains, without importing it.

    :param word: ``FILE.py:CLASS``; None is returned for ``MODULE:CLASS``
    :raises ValueError: for a file that does not exist
    """
    path = Path(word.rpartition(":")[0])
    if path.suffix != ".py":
        return None
    if not path.is_file():
        raise ValueError(f"the file {str(path)!r} does not exist")
    return hashlib.sha256(path.read_bytes()).hexdigest()


def resolved(kwargs: Mapping[str, Any]) -> dict[str, Any]:
    """Copy keyword arguments, and replace names of objects by the objects.

    :param kwargs: values; ``import:stable_baselines3:HerReplayBuffer``, for example, names a class
    :return: copies, which SB3 may change, with the imported objects
    :raises ValueError: for an unknown name
    """
    return {
        name: load_object(value.removeprefix(IMPORTED))
        if isinstance(value, str) and value.startswith(IMPORTED)
        else copy.deepcopy(value)
        for name, value in kwargs.items()
    }


def train(algorithm: type[Any], recorder: Recorder) -> dict[str, Any]:
    """Train an algorithm by the protocol.

    :param algorithm: a class of Stable-Baselines3, or one with the methods in the module's text
    :param recorder: of the run
    :return: the record
    :raises AlgorithmError: for a missing method, an invalid argument, or another environment than
        the algorithm supports
    """
    import gymnasium
    from stable_baselines3.common.base_class import BaseAlgorithm

    from saver_envs.registration import task_and_settings

    plan = recorder.plan
    kwargs = resolved(plan.algo_kwargs)
    is_class = inspect.isclass(algorithm)
    if is_class and issubclass(algorithm, BaseAlgorithm):
        return _train_sb3(algorithm, kwargs, recorder)
    lacking = [name for name in ("learn", "predict") if not hasattr(algorithm, name)]
    if is_class and lacking:
        raise AlgorithmError(f"{plan.algorithm} has no method {lacking[0]!r}")
    # Gymnasium would apply the registered length, also to slow arms, unlike the evaluations.
    options = plan.training_options
    horizon = task_and_settings(plan.env_id, options)[1].horizon
    env = gymnasium.make_vec(
        f"saver_envs:{plan.env_id}",
        plan.n_envs,
        vectorization_mode="vector_entry_point",
        **{**options, "max_episode_steps": horizon},
    )
    with contextlib.closing(CountedVectorEnv(env, recorder)) as counted:
        learner = _build(lambda: algorithm(counted, seed=plan.seed, **kwargs), recorder)
        recorder.begin(learner.predict, _weights_of(learner))
        # The budget is a regular end of the training.
        with contextlib.suppress(BudgetSpent):
            learner.learn(plan.total_steps)
        return recorder.finish()


def _train_sb3(algorithm: type[Any], kwargs: dict[str, Any], recorder: Recorder) -> dict[str, Any]:
    from stable_baselines3.common.noise import NormalActionNoise

    from saver_advisors.evaluation.protocol_env import ProtocolVecEnv
    from saver_envs.envs.sb3_vec_env import SaverVecEnv

    plan = recorder.plan

    def count(variables: dict[str, Any], _: object) -> bool:
        """Report every step to the recorder, and stop at the end of the budget."""
        cost = sum(float(info.get("cost", 0.0)) for info in variables["infos"])
        recorder.advance(model.num_timesteps - recorder.steps, cost)
        return not recorder.spent

    batch = SaverVecEnv(plan.env_id, n_envs=plan.n_envs, **plan.training_options)
    with contextlib.closing(ProtocolVecEnv(batch, plan.seed)) as env:
        policy = kwargs.pop("policy", "MultiInputPolicy")
        if (deviation := kwargs.pop(NOISE, None)) is not None:
            size = int(np.prod(env.action_space.shape or ()))
            kwargs["action_noise"] = NormalActionNoise(np.zeros(size), np.full(size, deviation))
        model = _build(lambda: algorithm(policy, env, seed=plan.seed, **kwargs), recorder)
        recorder.begin(
            lambda observation: model.predict(observation, deterministic=True)[0],
            _weights_of(model.policy),
        )
        model.learn(plan.total_steps, callback=count)
        return recorder.finish()


def _build(build: Callable[[], Any], recorder: Recorder) -> Any:
    """Call ``build``; report its errors in one line."""
    try:
        return build()
    except (TypeError, ValueError, AssertionError) as error:
        message = f"{recorder.plan.algorithm} cannot be built: {error}"
        raise AlgorithmError(" ".join(message.split())) from error


def _weights_of(owner: Any) -> Any:
    """Return an object if it has weights, else None: policies of SBX have them elsewhere."""
    named = ("state_dict", "load_state_dict")
    stored = all(callable(getattr(owner, name, None)) for name in named) and owner.state_dict()
    return owner if stored else None
