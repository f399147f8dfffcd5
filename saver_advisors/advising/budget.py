"""The advice budget n_b: counted once per environment step in which any arm was advised."""

from __future__ import annotations

import operator
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray


class AdviceBudget:
    """How many environment steps may still be advised.

    Exact inside a vector: where 5 remain and 8 environments want advice, the first 5 get it.

    :param total: the budget n_b in environment steps
    :raises TypeError: where it is no whole number
    :raises ValueError: where it is negative
    """

    def __init__(self, total: int) -> None:
        self._total = _count("total", total)
        self._spent = 0

    @property
    def total(self) -> int:
        """The budget n_b, in environment steps."""
        return self._total

    @property
    def spent(self) -> int:
        """Environment steps that were advised so far."""
        return self._spent

    @property
    def remaining(self) -> int:
        """Environment steps that may still be advised."""
        return self._total - self._spent

    def spend(self, wanted: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Pay for one step of a vector of environments.

        :param wanted: (n_envs,) whether any arm of that environment wants advice
        :return: (n_envs,) which environments get it: the first `remaining` of those that want it
        """
        wanted = np.asarray(wanted, dtype=bool)
        granted = wanted & (np.cumsum(wanted) <= self.remaining)
        self._spent += int(granted.sum())
        return granted

    def state_dict(self) -> dict[str, int]:
        """:return: JSON-able total and spent"""
        return {"total": self._total, "spent": self._spent}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from where a run stopped; this budget's own total stays in force, so a resumed run
        may raise it.

        :param state: what `state_dict` returned
        :raises ValueError: where more was spent than this budget holds
        """
        spent = _count("spent", state["spent"])
        if spent > self._total:
            raise ValueError(
                f"spent={spent} exceeds this budget's total of {self._total}: give a larger total"
            )
        self._spent = spent

    def __repr__(self) -> str:
        return f"AdviceBudget(total={self._total}, spent={self._spent})"


def _count(name: str, value: Any) -> int:
    if isinstance(value, (bool, np.bool_)):
        raise TypeError(
            f"{name}={value!r} must be a whole number of environment steps, not a truth value"
        )
    try:
        number = operator.index(value)
    except TypeError as error:
        raise TypeError(f"{name}={value!r} must be a whole number of environment steps") from error
    if number < 0:
        raise ValueError(
            f"{name}={number} must not be negative: give the number of environment steps to advise"
        )
    return number
