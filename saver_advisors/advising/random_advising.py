"""The same budget at random times: what any rule for choosing the moment has to beat."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from saver_advisors.advising.budget import AdviceBudget
from saver_advisors.advising.context import AdviceContext, Mask, RunPlan


class RandomAdvising:
    """All arms of an environment are advised at random steps.

    By default the budget is spread over the whole run: with b advised steps left to give and n
    steps left to do, a step is advised with probability b / n. That is sampling without
    replacement, so that every set of steps is as likely as any other, and the budget is spent to
    the last step at the end of the run, not sooner.

    :param probability: of each step instead, until the budget is spent; in (0, 1]
    :param seed: of the strategy's own generator; the run's where None
    :raises ValueError: for a probability outside (0, 1], or a negative seed
    """

    name: ClassVar[str] = "random"
    needs_critics: ClassVar[bool] = False

    def __init__(self, probability: float | None = None, seed: int | None = None) -> None:
        if probability is not None:
            number = isinstance(probability, (int, float)) and not isinstance(probability, bool)
            if not number or not math.isfinite(probability) or not 0.0 < probability <= 1.0:
                raise ValueError(f"probability={probability!r} must be a number in (0, 1]")
        if seed is not None and (type(seed) is not int or seed < 0):
            raise ValueError(f"seed={seed!r} must be a whole number of at least 0")
        self.probability = probability
        self.seed = seed
        self._total_steps: int | None = None
        self._random = np.random.default_rng(seed)

    @property
    def settings(self) -> Mapping[str, Any]:
        return {"probability": self.probability, "seed": self.seed}

    def begin(self, run: RunPlan, budget: AdviceBudget) -> None:
        """Take over the run's length and seed.

        :param run: its `total_steps` is needed where there is no `probability`
        :param budget: not used: what is left is asked for at each step
        :raises ValueError: where neither says how often to advise
        """
        if self.probability is None and run.total_steps is None:
            raise ValueError(
                "strategy 'random' spreads its budget over the run: give total_steps, or "
                "settings={'probability': 0.1}"
            )
        self._total_steps = run.total_steps
        # A stream of its own beside those that the run's seed starts elsewhere.
        seed = np.random.SeedSequence([run.seed, 0xAD]) if self.seed is None else self.seed
        self._random = np.random.default_rng(seed)

    def decide(self, context: AdviceContext) -> Mask:
        n_envs, n_arms = context.shape
        drawn = self._random.random(n_envs)
        if self.probability is not None:
            chosen = drawn < self.probability
        else:
            chosen = self._spread(drawn, context)
        return np.repeat(chosen[:, np.newaxis], n_arms, axis=1)

    def _spread(self, drawn: Any, context: AdviceContext) -> Mask:
        """One environment after the other, since each choice changes what is left for the next."""
        assert self._total_steps is not None, "`begin` comes first"
        to_give, to_do = context.budget.remaining, self._total_steps - context.steps
        chosen = np.zeros(len(drawn), dtype=bool)
        for index, number in enumerate(drawn):
            # A run that finishes its last block goes a little beyond its total: what is left goes.
            chosen[index] = number * max(to_do, 1) < to_give
            to_give -= int(chosen[index])
            to_do -= 1
        return chosen

    def state_dict(self) -> Mapping[str, Any]:
        """:return: JSON-able state of the generator"""
        return {"random": self._random.bit_generator.state}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """:param state: what `state_dict` returned"""
        self._random.bit_generator.state = state["random"]

    def __repr__(self) -> str:
        return f"RandomAdvising(probability={self.probability}, seed={self.seed})"
