"""Exploration by uniform actions that are held for several steps.

A uniform action at every fifth step moves a hand hardly at all: the next step undoes it. One that
is held for several steps carries the hand across the table, and pushes an object on its way.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from saver_envs.validation import require, require_share


class HeldActions:
    """Replace a fraction of all actions by uniform ones, each held for a while.

    The duration of an action is uniform between 1 and twice its mean, less 1, in steps. The actions
    of different environments, and of the explorers in one, are independent. They do not stop when
    an episode ends, so that every step of an episode is random equally often.

    :param fraction: of steps with a uniform action, in [0, 1].
    :param mean_steps: mean number of steps for which one is held, at least 1.
    :raises ValueError: if an argument is out of range.
    """

    def __init__(self, fraction: float, mean_steps: int = 1) -> None:
        require_share("random_action_probability", fraction)
        require("random_action_steps", mean_steps, mean_steps >= 1, "at least 1")
        self.mean_steps = mean_steps
        # Random and other steps alternate: the former last `mean_steps`, the latter
        # (1 - begin) / begin steps on average.
        self.begin = fraction / (fraction + mean_steps * (1.0 - fraction))
        self._left = np.zeros((0, 1), np.int64)
        self._action = np.zeros((0, 0))

    def replace(
        self, actions: npt.NDArray[Any], random: np.random.Generator, n_explorers: int = 1
    ) -> npt.NDArray[Any]:
        """Replace the actions of one step.

        :param actions: (n_envs, action_dim), scaled to [-1, 1].
        :param random: the source of randomness.
        :param n_explorers: parts of equal size that an action consists of, such as those of arms.
        :return: (n_envs, action_dim).
        """
        shape = len(actions), n_explorers
        if self._left.shape != shape or self._action.shape != actions.shape:
            self._left, self._action = np.zeros(shape, np.int64), np.zeros(actions.shape)
        begins = (self._left == 0) & (random.random(shape) < self.begin)
        width = actions.shape[1] // n_explorers
        chosen = np.repeat(begins, width, axis=1)
        self._action = np.where(chosen, random.uniform(-1.0, 1.0, actions.shape), self._action)
        # Of a single value, nothing is drawn from the generator.
        steps = random.integers(1, 2 * self.mean_steps, shape)
        self._left = np.where(begins, steps, self._left)
        held = np.repeat(self._left > 0, width, axis=1)
        self._left = np.maximum(self._left - 1, 0)
        return np.where(held, self._action, actions)

    def state_dict(self) -> dict[str, Any]:
        """Return the JSON-able state: the actions being held, and for how many more steps."""
        return {"left": self._left.tolist(), "action": self._action.tolist()}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore the result of ``state_dict``, which may come from JSON.

        :param state: ``left`` (n_envs, n_explorers) and ``action`` (n_envs, action_dim).
        """
        if state["left"]:  # else nothing has been replaced yet
            self._left = np.array(state["left"], np.int64)
            self._action = np.array(state["action"], np.float64)
