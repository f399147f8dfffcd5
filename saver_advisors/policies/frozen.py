"""Policies for use: a shipped one, and single-arm teachers that control n arms side by side."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saver_advisors.learner.arms import GOAL_KEYS
from saver_advisors.policies.cards import PolicyCard
from saver_advisors.policies.inference import FloatArray, FrozenPolicy
from saver_advisors.policies.mapping import ArmMapping
from saver_advisors.policies.networks import PolicyNetworks
from saver_advisors.policies.teacher import Teacher, TeacherGroup

Observation = Mapping[str, NDArray[Any]]


class _Predictor(ABC):
    """SB3's `predict` for a deterministic policy without an SB3 model or an environment."""

    @abstractmethod
    def _act(self, batch: dict[str, NDArray[Any]]) -> FloatArray:
        """Return (n, action size) for entries (n, size)."""

    def predict(
        self,
        observation: Observation,
        state: None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[FloatArray, None]:
        """Return the deterministic action, as SB3's `predict` does.

        :param observation: the environment's Dict observation, entries (size,) or (n, size).
        :param state: unused; part of SB3's signature.
        :param episode_start: unused; part of SB3's signature.
        :param deterministic: must be True, since only the mean action is stored.
        :return: (action size,) or (n, action size) in the environment's units, and None.
        :raises ValueError: if an entry is missing or its size differs.
        """
        del state, episode_start
        if not deterministic:
            raise ValueError("deterministic=False is not possible: frozen policies are not random")
        given = {key: np.asarray(observation[key]) for key in GOAL_KEYS if key in observation}
        if len({values.ndim for values in given.values()}) > 1:
            raise ValueError(f"the observation mixes single entries and batches: {sorted(given)}")
        single = all(values.ndim == 1 for values in given.values())
        actions = self._act({key: np.atleast_2d(values) for key, values in given.items()})
        return (actions[0] if single else actions), None


class PretrainedPolicy(_Predictor):
    """A frozen policy.

    :param networks: the weights.
    :param card: their origin.
    :param name: of the policy.
    """

    def __init__(self, networks: PolicyNetworks, card: PolicyCard, name: str) -> None:
        self.networks = networks
        self.card = card
        self.name = name
        self._policy = FrozenPolicy(networks, name)

    def _act(self, batch: dict[str, NDArray[Any]]) -> FloatArray:
        return self._policy.action(self._policy.features(batch))

    def teacher(self) -> Teacher:
        """Return a teacher with the same weights."""
        return Teacher(self.networks, self.name)

    def __repr__(self) -> str:
        return (
            f"PretrainedPolicy({self.name!r}, {self.card.env_id}, success {self.card.success:.3f})"
        )


class SideBySidePolicy(_Predictor):
    """n teachers control n arms without observing one another: the baseline for a student.

    :param teachers: one for all arms, or one per arm.
    :param n_arms: number of arms.
    :param shared_goal: size of the goal's part that belongs to no arm, if the teachers' goals end
        with it.
    :raises ValueError: if the number of teachers or the sizes do not match.
    """

    def __init__(
        self, teachers: Teacher | Sequence[Teacher], n_arms: int, shared_goal: int = 0
    ) -> None:
        self._group = TeacherGroup(teachers, n_arms)
        self.shared_goal = shared_goal
        first = self._group.teachers[0]
        self.mapping = ArmMapping(
            n_arms, first.observation_size, first.goal_size - shared_goal, first.action_size
        )

    def _act(self, batch: dict[str, NDArray[Any]]) -> FloatArray:
        seen, *goals = self.mapping.split(batch)
        if self.shared_goal:
            given = batch["desired_goal"], batch.get("achieved_goal")
            goals = [self._with_shared(*one) for one in zip(goals, given, strict=True)]
        return self.mapping.join_actions(self._group.act(seen, *goals))

    def _with_shared(self, blocks: Any, goal: NDArray[Any] | None) -> Any:
        """Append the shared part of goals (n, size) to each arm's block (n, n_arms, block)."""
        if goal is None:
            return None
        shape = *blocks.shape[:2], self.shared_goal
        shared = np.broadcast_to(goal[:, None, -self.shared_goal :], shape)
        return np.concatenate((blocks, shared), axis=2)


def side_by_side(
    teacher: Teacher | Sequence[Teacher], n_arms: int, shared_goal: int = 0
) -> SideBySidePolicy:
    """Return a policy for n arms from single-arm teachers, without a student.

    :param teacher: one for all arms, or one per arm.
    :param n_arms: number of arms.
    :param shared_goal: size of the goal's part that belongs to no arm, if the teachers' goals end
        with it, as those of PettingZoo's agents do.
    """
    return SideBySidePolicy(teacher, n_arms, shared_goal)
