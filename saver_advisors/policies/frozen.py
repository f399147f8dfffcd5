"""Policies to use: a shipped one, and single-arm teachers that drive n arms side by side without a
student.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saver_advisors.policies.cards import PolicyCard
from saver_advisors.policies.inference import FloatArray, FrozenPolicy
from saver_advisors.policies.mapping import ArmMapping
from saver_advisors.policies.networks import PolicyNetworks
from saver_advisors.policies.teacher import Teacher, TeacherGroup

Observation = Mapping[str, NDArray[Any]]


class PretrainedPolicy:
    """A frozen policy with SB3's `predict`; needs no SB3 model and no environment.

    :param networks: the weights
    :param card: where they come from
    :param name: what the policy is called
    """

    def __init__(self, networks: PolicyNetworks, card: PolicyCard, name: str) -> None:
        self.networks = networks
        self.card = card
        self.name = name
        self._policy = FrozenPolicy(networks)

    def predict(
        self,
        observation: Observation,
        state: None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[FloatArray, None]:
        """The deterministic action, as SB3's `predict` gives it.

        :param observation: the environment's Dict observation, one (size,) or a batch (n, size)
        :param state: no recurrent state; there for SB3's signature
        :param episode_start: the same
        :param deterministic: must be True: only the mean action was kept
        :return: (action_size,) or (n, action_size) in the environment's units, and None
        :raises ValueError: where an entry is missing or its size differs
        """
        del state, episode_start
        if not deterministic:
            raise ValueError(
                "deterministic=False is not possible: a weight file keeps the deterministic policy "
                "only"
            )
        batch, single = _batch(observation, self.networks.spec.inputs, self.name)
        actions = self._policy.action(self._policy.features(batch))
        return (actions[0] if single else actions), None

    def teacher(self) -> Teacher:
        """:return: a teacher with the same weights"""
        return Teacher(self.networks, self.name)

    def __repr__(self) -> str:
        return (
            f"PretrainedPolicy({self.name!r}, {self.card.env_id}, success {self.card.success:.3f})"
        )


class SideBySidePolicy:
    """n teachers drive n arms, each blind to the others: the baseline that a student has to beat.

    :param teachers: one for every arm, or one per arm
    :param n_arms: arms to drive
    """

    def __init__(self, teachers: Teacher | Sequence[Teacher], n_arms: int) -> None:
        self._group = TeacherGroup(teachers, n_arms)
        first = self._group.teachers[0]
        self.mapping = ArmMapping(
            n_arms, first.observation_size, first.goal_size, first.action_size
        )

    def predict(
        self,
        observation: Observation,
        state: None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[FloatArray, None]:
        """Every arm's teacher acts on its own block.

        :param observation: the n-arm environment's Dict observation, one or a batch
        :param state: not used
        :param episode_start: not used
        :param deterministic: must be True
        :return: (n_arms * action_size,) or (n, n_arms * action_size), and None
        :raises ValueError: where a size differs
        """
        del state, episode_start
        if not deterministic:
            raise ValueError("deterministic=False is not possible: teachers are deterministic")
        single = np.ndim(observation["observation"]) == 1
        flat = {key: np.atleast_2d(np.asarray(values)) for key, values in observation.items()}
        actions = self._group.act(
            self.mapping.split_observation(flat["observation"]),
            self.mapping.split_goal(flat["desired_goal"]),
            self.mapping.split_goal(flat["achieved_goal"])
            if self._group.reads_achieved_goal
            else None,
        )
        joined = self.mapping.join_actions(actions)
        return (joined[0] if single else joined), None


def side_by_side(teacher: Teacher | Sequence[Teacher], n_arms: int) -> SideBySidePolicy:
    """A policy for n arms from single-arm teachers, without a student.

    :param teacher: one for every arm, or one per arm
    :param n_arms: arms to drive
    """
    return SideBySidePolicy(teacher, n_arms)


def _batch(
    observation: Observation, inputs: tuple[tuple[str, int], ...], name: str
) -> tuple[dict[str, FloatArray], bool]:
    """:return: float32 (n, size) for each input, and whether a single observation was given"""
    batch = {}
    dimensions = set()
    for key, size in inputs:
        if key not in observation:
            raise ValueError(
                f"the observation has {sorted(observation)}, but policy {name!r} reads {key!r}"
            )
        values = np.ascontiguousarray(observation[key], dtype=np.float32)
        if values.ndim not in (1, 2) or values.shape[-1] != size:
            raise ValueError(
                f"{key} has shape {values.shape}: policy {name!r} needs ({size},) or (n, {size})"
            )
        dimensions.add(values.ndim)
        batch[key] = values.reshape(-1, size)
    if len(dimensions) != 1:
        raise ValueError(f"the observation mixes single entries and batches: {sorted(batch)}")
    return batch, dimensions == {1}
