"""A Lagrange multiplier that Adam learns."""

from __future__ import annotations

import math

import torch as th
from torch import nn

from saver_envs.validation import require


class LagrangeMultiplier(nn.Module):
    """A Lagrange multiplier on cost, which rises while the cost exceeds its limit.

    Gradient ascent of lambda (J_c - d), with Adam, projected to lambda >= 0. This is integral
    control, which oscillates. A proportional term damps it: the multiplier in use is
    max(0, lambda + gain (J_c - d)) (Stooke, Achiam and Abbeel, "Responsive Safety in Reinforcement
    Learning by PID Lagrangian Methods", arXiv 2007.03964).

    :param initial: value before the first update, at least 0.
    :param learning_rate: of Adam, above 0.
    :param gain: of the proportional term, per unit of cost, at least 0.
    :raises ValueError: if an argument is out of range.
    """

    excess: th.Tensor
    """J_c - d of the last update."""

    def __init__(self, initial: float, learning_rate: float, gain: float = 0.0) -> None:
        super().__init__()
        for name, value in (("multiplier_init", initial), ("multiplier_gain", gain)):
            require(name, value, 0.0 <= value < math.inf, "a finite number of at least 0")
        valid = 0.0 < learning_rate < math.inf
        require("multiplier_lr", learning_rate, valid, "a finite number above 0")
        self.gain = gain
        # Double precision: small steps are not lost on a large multiplier.
        self.value = nn.Parameter(th.tensor(float(initial), dtype=th.float64))
        # A buffer: a resumed run restores it.
        self.register_buffer("excess", th.zeros((), dtype=th.float64))
        self.optimizer = th.optim.Adam([self.value], lr=learning_rate)

    def update(self, mean_cost: float, cost_limit: float) -> float:
        """Take one step.

        :param mean_cost: J_c, mean sum of cost of an episode.
        :param cost_limit: d.
        :return: the multiplier in use.
        """
        self.excess.fill_(mean_cost - cost_limit)
        self.optimizer.zero_grad()
        loss = -self.value * (mean_cost - cost_limit)
        loss.backward()
        self.optimizer.step()
        with th.no_grad():
            self.value.clamp_(min=0.0)
        return float(self)

    def __float__(self) -> float:
        return max(0.0, float(self.value.detach()) + self.gain * float(self.excess))
