"""Batched environments in place of RL Zoo's vector of single ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import gymnasium
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker, TimeLimit
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecMonitor

from saver_envs.envs.goal_env import SaverGoalEnv
from saver_envs.envs.sb3_vec_env import SaverVecEnv

ALLOWED = (Monitor, OrderEnforcing, PassiveEnvChecker, TimeLimit)
"""Wrappers that the batch does not need."""
_DRAWING = ("env_id", "render_mode", "width", "height", "camera_name")


class BatchedVecEnv(VecMonitor):
    """n episodes stepped as one batch, with the monitor file that n single ones would write.

    RL Zoo uses it by way of `ExperimentManager.default_vec_env_cls`. Episodes equal those of a
    `DummyVecEnv` of the same functions: environment i is seeded with `seed + i`.

    :param env_fns: as for `DummyVecEnv`. All make the same environment of `saver_envs`, under
        SB3's `Monitor`; the first is called to find out which.
    :raises ValueError: for another environment, or a wrapper that a batch does not support.
    """

    def __init__(self, env_fns: Sequence[Callable[[], gymnasium.Env[Any, Any]]]) -> None:
        sample = env_fns[0]()
        monitor = _monitor_of(sample)
        env_id, options = _recipe(sample)
        sample.close()
        filename: str | None = None
        keywords: tuple[str, ...] = ()
        if monitor is not None:
            keywords = monitor.info_keywords
            if monitor.results_writer is not None:
                # The sample wrote a heading; the batch overwrites the file.
                filename = monitor.results_writer.file_handler.name
        super().__init__(SaverVecEnv(env_id, len(env_fns), **options), filename, keywords)


def _monitor_of(env: gymnasium.Env[Any, Any]) -> Monitor | None:
    """Return the monitor among an environment's wrappers, if any.

    :raises ValueError: for a wrapper that is not `ALLOWED`.
    """
    found = None
    while isinstance(env, gymnasium.Wrapper):
        if not isinstance(env, ALLOWED):
            raise ValueError(
                f"{type(env).__name__} wraps a single environment, and these are stepped as one "
                "batch: choose --vec-env dummy or subproc, or a vec_env_wrapper"
            )
        if isinstance(env, Monitor):
            found = env
        env = env.env
    return found


def _recipe(env: gymnasium.Env[Any, Any]) -> tuple[str, dict[str, Any]]:
    """Return the id and the options of an environment.

    :raises ValueError: for one that is not of `saver_envs`.
    """
    spec = env.unwrapped.spec
    if not isinstance(env.unwrapped, SaverGoalEnv) or spec is None:
        raise ValueError(f"{env} is not an environment of saver_envs: choose --vec-env dummy")
    options = {name: value for name, value in spec.kwargs.items() if name not in _DRAWING}
    limited = env.spec
    if limited is not None and limited.max_episode_steps is not None:
        options["max_episode_steps"] = limited.max_episode_steps
    return str(spec.kwargs["env_id"]), options
