"""A constrained control problem with a known optimum: a cart with a limited mean effort.

A cart starts with a small random speed and is accelerated by u in [-1, 1] for T steps::

    v_0 ~ U(-0.2, 0.2),    v_(t+1) = v_t + u_t / T,    reward v_(t+1),    cost u_t^2

The task is to travel as far as possible with a mean cost of at most d per episode. An effort at
step t changes the T - t speeds that follow, so the return is linear in the efforts::

    sum_t v_(t+1) = T v_0 + sum_t k_t u_t / T,    k_t = T - t

and v_0 is 0 on average. For any policy, deterministic or not, Cauchy-Schwarz over steps and
episodes gives::

    E sum_t k_t u_t  <=  sqrt(sum_t k_t^2) sqrt(E sum_t u_t^2)  <=  sqrt(d sum_t k_t^2)

with equality only for u_t = k_t sqrt(d / sum_t k_t^2): large efforts first, then smaller ones.
With sum_t k_t^2 = T (T + 1) (2 T + 1) / 6 the best mean return is::

    R* = sqrt(d (T + 1) (2 T + 1) / (6 T))

provided that u_0 = T sqrt(d / sum_t k_t^2) <= 1. Without the limit, u_t = 1 is optimal and costs T,
far more than d. Gaussian exploration does not change the mean return and adds its variance to the
cost.

The observation includes the remaining time, and an episode terminates after T steps, so the
objective is the undiscounted sum: learn with ``gamma=1`` and ``cost_gamma=1``.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from saver_envs.envs.sb3_vec_env import BatchVecEnv

HORIZON: Final = 20
COST_LIMIT: Final = 4.0
START_SPEED: Final = 0.2
Array = NDArray[np.float32]


def best_return(horizon: int = HORIZON, cost_limit: float = COST_LIMIT) -> float:
    """Return R*, the best mean return under the limit.

    :param horizon: T, steps.
    :param cost_limit: d, mean sum of squared efforts per episode; small enough for u_0 <= 1.
    """
    return math.sqrt(cost_limit * (horizon + 1) * (2 * horizon + 1) / (6 * horizon))


class EffortCartVecEnv(BatchVecEnv):
    """n carts stepped as arrays; the module describes the problem.

    Observation (2,): speed, and the remaining fraction of the episode. Action (1,): effort.

    :param n_envs: number of carts.
    :param horizon: T, steps per episode.
    :param seed: seed of the initial speeds.
    """

    def __init__(self, n_envs: int, horizon: int = HORIZON, seed: int | None = None) -> None:
        self.horizon = horizon
        self.render_mode = None
        low, high = np.array([-2.0, 0.0], np.float32), np.array([2.0, 1.0], np.float32)
        super().__init__(n_envs, spaces.Box(low, high), spaces.Box(-1.0, 1.0, (1,), np.float32))
        self._random = np.random.default_rng(seed)
        self._speed = np.zeros(n_envs)
        self._step = np.zeros(n_envs, np.int64)

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Seed the random stream, which all carts share."""
        self._random = np.random.default_rng(seed)
        return [seed] * self.num_envs

    def reset(self) -> Array:
        """Start all carts and return their observations (n_envs, 2)."""
        self._start(np.ones(self.num_envs, bool))
        return self._observation()

    def step_wait(self) -> tuple[Array, Array, NDArray[np.bool_], list[dict[str, Any]]]:
        """Apply the efforts; episodes that end are reset at once."""
        effort = np.clip(self._actions[:, 0].astype(np.float64), -1.0, 1.0)
        self._speed += effort / self.horizon
        self._step += 1
        rewards = self._speed.astype(np.float32)
        dones = self._step >= self.horizon
        infos: list[dict[str, Any]] = [{"cost": float(one) ** 2} for one in effort]
        if dones.any():
            last = self._observation()
            for index in np.flatnonzero(dones):
                infos[index]["terminal_observation"] = last[index]
                infos[index]["TimeLimit.truncated"] = False
            self._start(dones)
        return self._observation(), rewards, dones, infos

    def _start(self, which: NDArray[np.bool_]) -> None:
        count = int(which.sum())
        self._speed[which] = self._random.uniform(-START_SPEED, START_SPEED, count)
        self._step[which] = 0

    def _observation(self) -> Array:
        left = 1.0 - self._step / self.horizon
        return np.stack((self._speed, left), axis=1).astype(np.float32)

    def close(self) -> None:
        """Nothing to free."""
