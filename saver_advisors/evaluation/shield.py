"""An action shield: actions after which the constraint would be left are replaced before a step.

The simulator itself is the model. Each action is tried from the present state, followed by steps
without motion, since an arm that is told to stop needs some; then the episodes go back. Where the
requested action leaves the constraint's tolerance, changes of it are tried, the smallest first. The
first that stays within is executed; if none does, the one that deviates least. A real robot would
need a model of equal accuracy, so this is a bound on what a shield can do.

(Alshiekh et al., Safe Reinforcement Learning via Shielding, arXiv 1708.08611: post-posed shields.)
"""

from __future__ import annotations

from itertools import product
from typing import Final

import numpy as np
from numpy.typing import NDArray

from saver_advisors.evaluation.episodes import Observation, Predict
from saver_envs.episodes import Episodes

Floats = NDArray[np.float64]

BRAKING: Final = 3
"""Steps without motion in which a tried action must not leave the tolerance either."""
MEANS: Final = (1.0, 0.5, 0.0)
"""Factors of the arms' mean motion."""
DIFFERENCES: Final = (1.0, 0.5, 0.0, -0.5, -1.0)
"""Factors of the arms' differences from it."""
WAITS: Final = (0.5, 0.0, -0.3)
"""Factors of one arm's motion."""


class Shield:
    """A policy whose actions keep a task's constraint where the shield finds some that do.

    :param predict: the policy.
    :param episodes: those that are played; they are the model too.
    :param braking: steps without motion after a tried action.
    :raises ValueError: for a task without a constraint.
    """

    def __init__(self, predict: Predict, episodes: Episodes, braking: int = BRAKING) -> None:
        task = episodes.task
        if task.constraint is None:
            raise ValueError(f"a shield needs a task with a constraint; {task.name!r} has none")
        self.predict = predict
        self.episodes = episodes
        self.braking = braking
        self.tolerance = task.constraint[1]

    def __call__(self, observation: Observation) -> NDArray[np.float64]:
        """Return actions (n, action size) that keep the constraint, if there are any."""
        action = np.clip(self.predict(observation), -1.0, 1.0).astype(np.float64)
        tried = self._variants(action)
        before = self.episodes.get_state()
        rows = np.arange(len(action))
        least = np.full(len(action), np.inf)
        chosen = action.copy()
        for one in tried:
            deviation = self._deviation(one, rows)
            self.episodes.set_state(before)
            better = deviation < least[rows]
            chosen[rows[better]] = one[rows[better]]
            least[rows] = np.minimum(least[rows], deviation)
            rows = rows[deviation > self.tolerance]
            if not rows.size:
                break
        return chosen

    def _variants(self, action: Floats) -> Floats:
        """Return changes (variants, n, action size) of actions, from none to the greatest.

        In some, one arm waits for the others or moves back. In the others, the mean motion of all
        arms is slower, and so is each arm's difference from it, or it is reversed.
        """
        episodes = self.episodes
        blocks = action.reshape(len(action), episodes.task.n_arms, -1)
        motion = blocks[..., : episodes.motion_size]
        common = motion.mean(axis=1, keepdims=True)
        motions = [motion]  # as requested: the first two factors would round it
        for mean, other in list(product(MEANS, DIFFERENCES))[1:]:
            motions.append(mean * common + other * (motion - common))
        for factor, arm in product(WAITS, range(blocks.shape[1])):
            motions.append(motion.copy())
            motions[-1][:, arm] *= factor
        variants = np.stack([blocks] * len(motions))
        variants[..., : episodes.motion_size] = np.stack(motions)
        variants = variants.reshape(len(motions), *action.shape)
        order = np.square(variants - action).sum(axis=-1).argsort(axis=0, stable=True)
        return np.take_along_axis(variants, order[..., None], axis=0)

    def _deviation(self, action: Floats, rows: NDArray[np.intp]) -> Floats:
        """Play actions; return the largest deviation (k,) of the constraint's value in ``rows``."""
        episodes, task = self.episodes, self.episodes.task
        still = action.reshape(len(action), task.n_arms, -1).copy()
        still[..., : episodes.motion_size] = 0.0
        worst = np.zeros(len(action))
        for sent in (action, *[still.reshape(action.shape)] * self.braking):
            episodes.step(sent, rows)
            seen = episodes.observation()
            worst = np.maximum(worst, task.deviation(seen.achieved_goal, seen.desired_goal))
        return worst[rows]
