"""What on-policy algorithms keep about costs: the rollout, and the sums of whole episodes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]


def read_costs(infos: Sequence[dict[str, Any]], key: str) -> Array:
    """The costs of one step.

    :param infos: one an environment
    :param key: the entry that holds the cost
    :return: (n_envs,)
    :raises ValueError: where an entry is missing, no number, infinite or NaN
    """
    costs = np.zeros(len(infos), np.float32)
    for index, info in enumerate(infos):
        if key not in info:
            there = ", ".join(sorted(info)) or "nothing"
            raise ValueError(
                f"environment {index} reports no info[{key!r}] (there is {there}): a constrained "
                f"algorithm needs the cost of every step there, or cost_key to name another entry"
            )
        try:
            costs[index] = np.asarray(info[key], np.float64).item()
        except (TypeError, ValueError):
            raise ValueError(
                f"info[{key!r}]={info[key]!r} of environment {index} must be one number"
            ) from None
        if not np.isfinite(costs[index]):
            raise ValueError(
                f"info[{key!r}]={info[key]!r} of environment {index} must be a finite number: no "
                f"constraint can be checked against it"
            )
    return costs


def generalized_advantages(
    signal: Array,
    values: Array,
    last_values: Array,
    episode_starts: NDArray[Any],
    dones: NDArray[Any],
    gamma: float,
    gae_lambda: float,
) -> Array:
    """Generalized advantage estimates (Schulman et al., 2016) of rewards or of costs.

    :param signal: (steps, n_envs) reward or cost of each step; where a time limit cut an episode
        off, with gamma times the value of its last state added
    :param values: (steps, n_envs) of the states acted in
    :param last_values: (n_envs,) of the states after the last step
    :param episode_starts: (steps, n_envs) whether a step is the first of its episode
    :param dones: (n_envs,) whether the last step ended its episode
    :param gamma: discount
    :param gae_lambda: 0 for one-step differences, 1 for whole returns
    :return: (steps, n_envs); plus ``values`` they are the targets of a value function
    """
    advantages = np.zeros_like(values)
    following = np.zeros_like(last_values)
    goes_on = 1.0 - np.asarray(dones, np.float32)
    next_values = last_values
    for step in reversed(range(len(signal))):
        difference = signal[step] + gamma * goes_on * next_values - values[step]
        following = difference + gamma * gae_lambda * goes_on * following
        advantages[step] = following
        goes_on = 1.0 - np.asarray(episode_starts[step], np.float32)
        next_values = values[step]
    return advantages


class CostRollout:
    """Costs beside SB3's rollout buffer: the same steps, in the same order.

    :param n_steps: of a rollout, per environment
    :param n_envs: number of environments
    """

    def __init__(self, n_steps: int, n_envs: int) -> None:
        self.costs = np.zeros((n_steps, n_envs), np.float32)
        self.values = np.zeros((n_steps, n_envs), np.float32)
        self.advantages = np.zeros((n_steps, n_envs), np.float32)
        self.episode_starts = np.zeros((n_steps, n_envs), bool)
        self.position = 0

    @property
    def returns(self) -> Array:
        """(n_steps, n_envs) what the cost critic should have said."""
        targets: Array = self.advantages + self.values
        return targets

    def reset(self) -> None:
        """Begin a rollout."""
        self.position = 0

    def add(self, costs: Array, values: Array, episode_starts: NDArray[Any]) -> None:
        """Keep a step.

        :param costs: (n_envs,), with the bootstrap of episodes cut off by a time limit
        :param values: (n_envs,) the cost critic's, of the states acted in
        :param episode_starts: (n_envs,) whether the step is the first of its episode
        """
        self.costs[self.position] = costs
        self.values[self.position] = values
        self.episode_starts[self.position] = episode_starts
        self.position += 1

    def finish(
        self, last_values: Array, dones: NDArray[Any], gamma: float, gae_lambda: float
    ) -> None:
        """Compute the advantages of a full rollout; see :func:`generalized_advantages`."""
        assert self.position == len(self.costs), "the rollout is not full"
        self.advantages = generalized_advantages(
            self.costs, self.values, last_values, self.episode_starts, dones, gamma, gae_lambda
        )


class EpisodeCosts:
    """Undiscounted sums of cost over episodes, which run on across rollouts.

    :param n_envs: number of environments
    """

    def __init__(self, n_envs: int) -> None:
        self._sums = np.zeros(n_envs)
        self._lengths = np.zeros(n_envs, np.int64)
        self._whole = np.ones(n_envs, bool)
        self._ended: list[tuple[float, int]] = []

    def restart(self) -> None:
        """All environments were reset: what was running counts no more."""
        self._sums[:] = 0.0
        self._lengths[:] = 0
        self._whole[:] = True

    def interrupt(self) -> None:
        """A step was lost: what is running is not whole and will not be counted."""
        self._whole[:] = False

    def add(self, costs: Array, dones: NDArray[Any]) -> None:
        """Count a step.

        :param costs: (n_envs,) as the environments reported them
        :param dones: (n_envs,) whether the step ended its episode
        """
        self._sums += costs
        self._lengths += 1
        for index in np.flatnonzero(dones):
            if self._whole[index]:
                self._ended.append((float(self._sums[index]), int(self._lengths[index])))
            self._sums[index], self._lengths[index], self._whole[index] = 0.0, 0, True

    def take(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """The episodes that ended since the last call.

        :return: their sums of cost and their lengths in steps, (episodes,) each
        """
        ended, self._ended = self._ended, []
        sums = np.array([one[0] for one in ended], np.float64)
        return sums, np.array([one[1] for one in ended], np.int64)
