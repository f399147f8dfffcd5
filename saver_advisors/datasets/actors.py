"""What chooses the actions of a data set's episodes: a policy, with noise, or with advice."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from saver_advisors.advising import Advisor
from saver_advisors.evaluation.episodes import Observation, Predict
from saver_envs.validation import require

MEDIUM_NOISE: Final = 1.0
"""Standard deviation of the noise of medium data sets, of actions that span [-1, 1]."""

_NOISE_STREAM: Final = 1
"""Separates the noise of an episode from the draws of its reset, which has the same seed."""

Acted = tuple[NDArray[Any], Mapping[str, NDArray[Any]]]
"""Actions (n, action size), and notes about them, (n, ...) by name, for the episodes' infos."""


class Actor:
    """Act as a policy does.

    :param predict: batched observation (n, size) -> actions (n, action size)
    """

    def __init__(self, predict: Predict) -> None:
        self.predict = predict

    def begin(self, seeds: Sequence[int]) -> None:
        """Prepare for a batch of episodes that start now.

        :param seeds: (n,) of the episodes
        """

    def act(self, observation: Observation) -> Acted:
        """Choose an action in each of the episodes.

        :param observation: entries (n, size)
        :return: actions in the environment's units, and notes about them
        """
        return self.predict(observation), {}


class NoisyActor(Actor):
    """Add Gaussian noise to a policy's actions, drawn from the seed of each episode.

    :param predict: as for :class:`Actor`
    :param noise: standard deviation; actions span [-1, 1] and are clipped to it
    :raises ValueError: for noise below 0, or that is not finite
    """

    def __init__(self, predict: Predict, noise: float = MEDIUM_NOISE) -> None:
        require("noise", noise, 0.0 <= noise < float("inf"), "0 or more")
        super().__init__(predict)
        self.noise = noise

    def begin(self, seeds: Sequence[int]) -> None:
        """Draw the noise of each episode from its own seed."""
        self._random = [np.random.default_rng([seed, _NOISE_STREAM]) for seed in seeds]

    def act(self, observation: Observation) -> Acted:
        """Choose the policy's actions with noise."""
        actions = self.predict(observation)
        noise = np.stack([one.standard_normal(actions.shape[1]) for one in self._random])
        return np.clip(actions + self.noise * noise, -1.0, 1.0).astype(np.float32), {}


class AdvisedActor(Actor):
    """Let a teacher replace a student's actions where a strategy decides so.

    The notes have ``advised``, (n, arms): whether the action of an arm is the teacher's.

    :param student: chooses the actions that may be replaced
    :param advisor: with the teacher, the strategy and the budget
    """

    def __init__(self, student: Actor, advisor: Advisor) -> None:
        super().__init__(student.predict)
        self.student = student
        self.advisor = advisor

    def begin(self, seeds: Sequence[int]) -> None:
        """Prepare the student; the episodes are at step 0."""
        self.student.begin(seeds)
        self._steps = np.zeros(len(seeds), np.int64)

    def act(self, observation: Observation) -> Acted:
        """Choose the student's actions, some of them replaced by the teacher's."""
        actions, notes = self.student.act(observation)
        advice = self.advisor.advise(observation, actions, episode_steps=self._steps)
        self._steps = self._steps + 1
        return advice.actions, {**notes, "advised": advice.mask}
