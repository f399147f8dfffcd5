"""Which arms would do better by another's action, in the eyes of a critic of all arms."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import torch as th

Values = Callable[[npt.NDArray[Any]], npt.NDArray[np.float32]]
"""Actions of all arms, (k, batch, n_arms * action_size) -> values (k, batch, values)."""


class Proposals(Protocol):
    """Somebody else's actions in given states."""

    @property
    def arms(self) -> npt.NDArray[np.bool_]:
        """(n_arms,) which arms may take a proposed action."""

    def __call__(self, observations: Mapping[str, th.Tensor]) -> npt.NDArray[np.float32] | None:
        """
        :param observations: entries (batch, dim)
        :return: (batch, n_arms, action_size) scaled to [-1, 1], or None for no proposals
        """


def better_by_arm(
    own: npt.NDArray[Any],
    proposed: npt.NDArray[Any],
    values: Values,
    arms: npt.NDArray[np.bool_],
) -> npt.NDArray[np.bool_]:
    """Where each arm should take the proposed action in place of its own.

    A single value is asked about all combinations of own and proposed actions, and the best one
    wins. With several values, value i is arm i's, and those beyond the last arm's are everybody's:
    each arm compares the two actions while all the others keep their own. Ties go to the own
    action.

    :param own: (batch, n_arms, action_size)
    :param proposed: (batch, n_arms, action_size)
    :param values: the critic, in the states that the actions belong to
    :param arms: (n_arms,) which arms may take a proposed action
    :return: (batch, n_arms)
    :raises ValueError: for several values, but fewer than arms
    """
    n_arms = own.shape[1]
    free = np.flatnonzero(arms)
    # One arm at a time first, in the order of `combinations`: no arm, then each alone, ...
    sets = [
        chosen for size in range(len(free) + 1) for chosen in itertools.combinations(free, size)
    ]
    single = sets[: 1 + len(free)]
    masks = np.zeros((len(sets), n_arms), dtype=bool)
    for mask, chosen in zip(masks, sets, strict=True):
        mask[list(chosen)] = True
    alone = _ask(values, own, proposed, masks[: len(single)])
    n_values = alone.shape[2]
    if n_values == 1:
        rest = masks[len(single) :]
        both = [alone, _ask(values, own, proposed, rest)] if len(rest) else [alone]
        best: npt.NDArray[np.bool_] = masks[np.concatenate(both)[:, :, 0].argmax(axis=0)]
        return best
    if n_values < n_arms:
        raise ValueError(f"the critic gives {n_values} values for {n_arms} arms: one each, or one")
    better = np.zeros(own.shape[:2], dtype=bool)
    for row, arm in enumerate(free, start=1):
        gain = alone[row] - alone[0]
        better[:, arm] = gain[:, arm] + gain[:, n_arms:].sum(axis=1) > 0
    return better


def _ask(
    values: Values,
    own: npt.NDArray[Any],
    proposed: npt.NDArray[Any],
    masks: npt.NDArray[np.bool_],
) -> npt.NDArray[np.float32]:
    """Values (k, batch, values) of the k mixtures of own and proposed actions."""
    mixed = np.where(masks[:, np.newaxis, :, np.newaxis], proposed, own)
    return values(mixed.reshape(len(masks), len(own), -1))
