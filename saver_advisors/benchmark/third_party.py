"""Algorithms that are not ours: found by name, given an environment, held to their budget.

Two kinds are taken. A class of Stable-Baselines3's (or one with its interface and base class) is
built with ``MultiInputPolicy`` and a vector environment, and watched through a callback. Anything
else has the three methods of ``Algorithm``.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import importlib.util
import inspect
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, Protocol, cast

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from numpy.typing import NDArray

from saver_advisors.benchmark.recorder import Predict, Recorder, Weights
from saver_advisors.evaluation.protocol import training_seed

IMPORTED: Final = "import:"
"""What a keyword argument begins with that names a class or a function."""

NOISE: Final = "noise_std"
"""Of SB3's algorithms, as RL Zoo calls it: their action noise is an object, and no text."""

Observation = dict[str, NDArray[Any]]


class Algorithm(Protocol):
    """What an algorithm outside of Stable-Baselines3 has.

    Optional: ``state_dict()`` and ``load_state_dict(state)``, as torch's modules have them, of all
    that ``predict`` depends on. With them the best checkpoint is reported, without them the last.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], *, seed: int, **kwargs: Any) -> None:
        """
        :param env: n episodes with Dict observations, behind Gymnasium's vector API; its
            ``unwrapped.compute_reward(achieved, desired, info)`` takes arrays (..., goal_size)
        :param seed: of everything random
        :param kwargs: what ``--algo-kwargs`` says
        """

    def learn(self, steps: int) -> None:
        """Train in the environment for so many environment steps, all episodes' together. A step
        beyond them is refused with ``BudgetSpent``, which may be let through.
        """

    def predict(self, observation: Observation) -> NDArray[Any]:
        """Actions (n, action_size) for observations with entries (n, size), deterministic and
        without a lasting effect: it is called in the midst of training.
        """


class BudgetSpent(Exception):
    """All environment steps of the run are done."""


class AlgorithmError(Exception):
    """The algorithm cannot be built, or lacks what the protocol needs."""


class CountedVectorEnv(VectorWrapper):
    """A vector environment that counts its steps, and keeps training off the evaluations' seeds.

    :param env: with automatic reset at the next step, or in the same one, or none
    :param recorder: counts, evaluates, and knows the budget
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
        """As the environment's, from a training seed for the seed that is given; the first reset
        takes the run's seed where none is.

        :param seed: a number, one an episode, or None
        :param options: as the environment's
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
        """As the environment's; steps that only reset an episode do not count.

        :raises BudgetSpent: where all steps of the run are done
        """
        if self._recorder.spent:
            raise BudgetSpent(f"all {self._recorder.plan.total_steps} environment steps are done")
        result = self.env.step(actions)
        _, _, terminated, truncated, _ = result
        counted = self.num_envs
        if self._resets_at_next_step:
            counted -= int(self._over.sum())
            self._over = np.asarray(terminated | truncated)
        self._recorder.advance(counted)
        return result


def load_class(word: str) -> type[Any]:
    """The class that ``MODULE:CLASS`` or ``FILE.py:CLASS`` names.

    :param word: as given; modules in the current folder are found
    :return: the class, or whatever builds an algorithm when it is called
    :raises ValueError: where it is not of that form, or names nothing that can be called
    """
    found = load_object(word)
    if not callable(found):
        raise ValueError(f"{word!r} is no class: it cannot be called")
    return cast("type[Any]", found)


def load_object(word: str) -> Any:
    """What ``MODULE:NAME`` or ``FILE.py:NAME`` names.

    :param word: as given
    :return: the object
    :raises ValueError: where it names nothing
    """
    module_name, colon, name = word.rpartition(":")
    if not colon or not module_name or not name:
        raise ValueError(f"{word!r} must read MODULE:CLASS or FILE.py:CLASS")
    try:
        module = _module_of(module_name)
    except ImportError as error:
        raise ValueError(f"{module_name!r} cannot be imported: {error}") from error
    if not hasattr(module, name):
        public = [key for key, value in vars(module).items() if inspect.isclass(value)]
        raise ValueError(f"{module_name!r} has no {name!r}; its classes are {', '.join(public)}")
    return getattr(module, name)


def _module_of(name: str) -> Any:
    """An importable module, or a file."""
    if not name.endswith(".py"):
        if (here := os.getcwd()) not in sys.path:
            sys.path.insert(0, here)  # as `python -m` does, and a console script does not
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


def source_sha256(algorithm: Any) -> str | None:
    """The digest of the file that an algorithm is in, None where it has none."""
    try:
        return hashlib.sha256(Path(inspect.getfile(algorithm)).read_bytes()).hexdigest()
    except (TypeError, OSError):
        return None


def resolved(kwargs: Mapping[str, Any]) -> dict[str, Any]:
    """Keyword arguments with what they name in place of its name.

    :param kwargs: values; one such as ``import:stable_baselines3:HerReplayBuffer`` names a class
    :return: the same, those imported
    :raises ValueError: where one names nothing
    """
    return {
        name: load_object(value.removeprefix(IMPORTED))
        if isinstance(value, str) and value.startswith(IMPORTED)
        else value
        for name, value in kwargs.items()
    }


def train(algorithm: type[Any], recorder: Recorder) -> dict[str, Any]:
    """Train an algorithm by the protocol.

    :param algorithm: a class of either kind
    :param recorder: of the run
    :return: its record
    :raises AlgorithmError: where it lacks a method, or refuses an argument or the environment
    """
    kwargs = resolved(recorder.plan.algo_kwargs)
    if _is_sb3(algorithm):
        return _train_sb3(algorithm, kwargs, recorder)
    for name in ("learn", "predict"):
        if inspect.isclass(algorithm) and not hasattr(algorithm, name):
            raise AlgorithmError(f"{recorder.plan.algorithm} has no method {name!r}")
    return _train_plain(algorithm, kwargs, recorder)


def _is_sb3(algorithm: Any) -> bool:
    from stable_baselines3.common.base_class import BaseAlgorithm

    return inspect.isclass(algorithm) and issubclass(algorithm, BaseAlgorithm)


def _train_sb3(algorithm: type[Any], kwargs: dict[str, Any], recorder: Recorder) -> dict[str, Any]:
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.noise import NormalActionNoise

    from saver_envs.envs.sb3_vec_env import SaverVecEnv

    plan = recorder.plan

    class Count(BaseCallback):
        """Tells the recorder of every step, and ends the run with its budget."""

        def _on_step(self) -> bool:
            recorder.advance(self.num_timesteps - recorder.steps)
            return not recorder.spent

    env = SaverVecEnv(plan.env_id, n_envs=plan.n_envs, **plan.env_kwargs)
    try:
        policy = kwargs.pop("policy", "MultiInputPolicy")
        if (deviation := kwargs.pop(NOISE, None)) is not None:
            size = int(np.prod(env.action_space.shape or ()))
            kwargs["action_noise"] = NormalActionNoise(np.zeros(size), np.full(size, deviation))
        model = _build(lambda: algorithm(policy, env, seed=plan.seed, **kwargs), recorder)
        # The constructor seeded the environments with the run's own seed.
        env.seed(training_seed(plan.seed))
        recorder.begin(
            lambda observation: model.predict(observation, deterministic=True)[0],
            _weights_of(model.policy),
        )
        model.learn(plan.total_steps, callback=Count())
        return recorder.finish()
    finally:
        env.close()


def _train_plain(
    algorithm: type[Any], kwargs: dict[str, Any], recorder: Recorder
) -> dict[str, Any]:
    import gymnasium

    plan = recorder.plan
    env = gymnasium.make_vec(
        f"saver_envs:{plan.env_id}",
        plan.n_envs,
        vectorization_mode="vector_entry_point",
        **plan.env_kwargs,
    )
    try:
        counted = CountedVectorEnv(env, recorder)
        learner = _build(lambda: algorithm(counted, seed=plan.seed, **kwargs), recorder)
        predict: Predict = learner.predict
        recorder.begin(predict, _weights_of(learner))
        # It has had its steps: an end like any other.
        with contextlib.suppress(BudgetSpent):
            learner.learn(plan.total_steps)
        return recorder.finish()
    finally:
        env.close()


def _build(build: Callable[[], Any], recorder: Recorder) -> Any:
    """What ``build`` returns; its complaints about arguments in one line."""
    try:
        return build()
    except (TypeError, ValueError, AssertionError) as error:
        message = f"{recorder.plan.algorithm} cannot be built: {error}"
        raise AlgorithmError(" ".join(message.split())) from error


def _weights_of(owner: Any) -> Weights | None:
    """What has weights to be kept, or None."""
    named = ("state_dict", "load_state_dict")
    return owner if all(callable(getattr(owner, name, None)) for name in named) else None
