"""The Lagrange multiplier of a cost limit, learned by Adam, with a proportional term."""

from __future__ import annotations

import math

import torch as th
from torch import nn


class LagrangeMultiplier(nn.Module):
    """The price of a unit of cost, which rises while a policy costs more than it may.

    Gradient ascent of lambda (J_c - d), with Adam, projected to lambda >= 0. That is integral
    control: the price lags behind the policy that answers it, and both swing. A proportional term
    damps them: the price is max(0, lambda + gain (J_c - d)) (Stooke, Achiam and Abbeel, "Responsive
    Safety in Reinforcement Learning by PID Lagrangian Methods", arXiv 2007.03964).

    :param initial: its first value, at least 0
    :param learning_rate: of Adam, above 0
    :param gain: of the proportional term, price a unit of cost, at least 0
    :raises ValueError: for an argument out of range
    """

    excess: th.Tensor
    """J_c - d of the last update."""

    def __init__(self, initial: float, learning_rate: float, gain: float = 0.0) -> None:
        super().__init__()
        if not (math.isfinite(initial) and initial >= 0.0):
            raise ValueError(f"multiplier_init={initial} must be a finite number of at least 0")
        if not (math.isfinite(learning_rate) and learning_rate > 0.0):
            raise ValueError(f"multiplier_lr={learning_rate} must be a finite number above 0")
        if not (math.isfinite(gain) and gain >= 0.0):
            raise ValueError(f"multiplier_gain={gain} must be a finite number of at least 0")
        self.gain = gain
        # Double precision: small steps are not lost on a large price.
        self.value = nn.Parameter(th.tensor(float(initial), dtype=th.float64))
        # A buffer: a resumed run goes on with the price that it had.
        self.register_buffer("excess", th.zeros((), dtype=th.float64))
        self.optimizer = th.optim.Adam([self.value], lr=learning_rate)

    def update(self, mean_cost: float, cost_limit: float) -> float:
        """One step.

        :param mean_cost: J_c, mean sum of cost of an episode
        :param cost_limit: d
        :return: the new price
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
