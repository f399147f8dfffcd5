"""A constrained control problem whose optimum is known: a cart with a budget of effort.

A cart starts at rest, up to a push, and is accelerated by u in [-1, 1] for T steps::

    v_0 ~ U(-0.2, 0.2),    v_(t+1) = v_t + u_t / T,    reward v_(t+1),    cost u_t^2

It shall get as far as it can on a mean effort of d an episode. What is pushed at step t is
felt in the T - t speeds that follow, so the return is linear in the efforts::

    sum_t v_(t+1) = T v_0 + sum_t k_t u_t / T,    k_t = T - t

and v_0 is 0 on average. For any policy, whatever it observes and draws, Cauchy-Schwarz over steps
and episodes gives::

    E sum_t k_t u_t  <=  sqrt(sum_t k_t^2) sqrt(E sum_t u_t^2)  <=  sqrt(d sum_t k_t^2)

with equality for u_t = k_t sqrt(d / sum_t k_t^2) alone: push hard at first, then less and less.
With sum_t k_t^2 = T (T + 1) (2 T + 1) / 6 the best mean return is::

    R* = sqrt(d (T + 1) (2 T + 1) / (6 T))

provided that u_0 = T sqrt(d / sum_t k_t^2) <= 1. Without the budget u_t = 1 is best, which costs T,
far beyond d. Gaussian exploration leaves the return as it is and adds its variance to the cost.

The time left is observed and an episode ends for good after T steps, so that sums are the
objective: learn with ``gamma=1`` and ``cost_gamma=1``.
"""

from __future__ import annotations

import math
from typing import Any, Final

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

HORIZON: Final = 20
COST_LIMIT: Final = 4.0
START_SPEED: Final = 0.2
Array = NDArray[np.float32]


def best_efforts(horizon: int = HORIZON, cost_limit: float = COST_LIMIT) -> NDArray[np.float64]:
    """The optimal efforts.

    :param horizon: T, steps
    :param cost_limit: d, mean sum of squared efforts of an episode
    :return: (horizon,)
    :raises ValueError: where they leave [-1, 1], and the closed form with them
    """
    left = np.arange(horizon, 0, -1, dtype=np.float64)
    efforts: NDArray[np.float64] = left * math.sqrt(cost_limit / float(np.sum(left**2)))
    if efforts[0] > 1.0:
        raise ValueError(
            f"cost_limit={cost_limit} is too much for {horizon} steps: the best first effort would "
            f"be {efforts[0]:.3g}, above 1"
        )
    return efforts


def best_return(horizon: int = HORIZON, cost_limit: float = COST_LIMIT) -> float:
    """R*, the best mean return under the limit; arguments as for :func:`best_efforts`."""
    best_efforts(horizon, cost_limit)
    return math.sqrt(cost_limit * (horizon + 1) * (2 * horizon + 1) / (6 * horizon))


class EffortCartVecEnv(VecEnv):
    """n carts stepped as arrays; see the module for the problem.

    Observation (2,): speed, and the share of the episode that is left. Action (1,): effort.

    :param n_envs: number of carts
    :param horizon: T, steps of an episode
    :param seed: of the starting speeds
    """

    def __init__(self, n_envs: int, horizon: int = HORIZON, seed: int | None = None) -> None:
        self.horizon = horizon
        self.render_mode = None
        low, high = np.array([-2.0, 0.0], np.float32), np.array([2.0, 1.0], np.float32)
        super().__init__(n_envs, spaces.Box(low, high), spaces.Box(-1.0, 1.0, (1,), np.float32))
        self._random = np.random.default_rng(seed)
        self._speed = np.zeros(n_envs)
        self._step = np.zeros(n_envs, np.int64)
        self._returns = np.zeros(n_envs)
        self._actions = np.zeros((n_envs, 1))

    def seed(self, seed: int | None = None) -> list[int | None]:
        """One stream for all carts, begun anew."""
        self._random = np.random.default_rng(seed)
        return [seed] * self.num_envs

    def reset(self) -> Array:
        """Start all carts; (n_envs, 2)."""
        self._start(np.ones(self.num_envs, bool))
        return self._observation()

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the efforts (n_envs, 1) for `step_wait`."""
        self._actions = np.asarray(actions, np.float64)

    def step_wait(self) -> tuple[Array, Array, NDArray[np.bool_], list[dict[str, Any]]]:
        """Apply the efforts; carts at their end are started again at once."""
        effort = np.clip(self._actions[:, 0], -1.0, 1.0)
        self._speed += effort / self.horizon
        self._step += 1
        rewards = self._speed.astype(np.float32)
        self._returns += rewards
        dones = self._step >= self.horizon
        infos: list[dict[str, Any]] = [{"cost": float(one) ** 2} for one in effort]
        if dones.any():
            last = self._observation()
            for index in np.flatnonzero(dones):
                infos[index]["terminal_observation"] = last[index]
                infos[index]["TimeLimit.truncated"] = False
                infos[index]["episode"] = {"r": self._returns[index], "l": self.horizon, "t": 0.0}
            self._start(dones)
        return self._observation(), rewards, dones, infos

    def _start(self, which: NDArray[np.bool_]) -> None:
        count = int(which.sum())
        self._speed[which] = self._random.uniform(-START_SPEED, START_SPEED, count)
        self._step[which] = 0
        self._returns[which] = 0.0

    def _observation(self) -> Array:
        left = 1.0 - self._step / self.horizon
        return np.stack((self._speed, left), axis=1).astype(np.float32)

    def close(self) -> None:
        """Nothing to free."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute, the same for every cart asked for."""
        return [getattr(self, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of the whole vector."""
        setattr(self, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method once and return its result for every cart asked for."""
        result = getattr(self, method_name)(*method_args, **method_kwargs)
        return [result] * len(list(self._get_indices(indices)))

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper[Any, Any, Any, Any]], indices: Any = None
    ) -> list[bool]:
        """Return False for every cart: there are no single environments to wrap."""
        return [False] * len(list(self._get_indices(indices)))
