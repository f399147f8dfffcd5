"""Steps within a trust region under one linear constraint, for CPO.

Maximise g'x subject to c + b'x <= 0 and x'Hx / 2 <= delta, for a Fisher matrix H that is given by
its products with vectors (Achiam et al., 2017, theorem 2 and appendix; there for a minimum).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal

import torch as th
from sb3_contrib.common.utils import conjugate_gradient_solver

Case = Literal["unconstrained", "feasible", "recoverable", "infeasible"]
"""Relation of the trust region to the constraint:

- ``unconstrained``: the whole region satisfies the constraint, which is inactive
- ``feasible``: the current policy satisfies the constraint, parts of the region do not
- ``recoverable``: the current policy violates it, parts of the region do not
- ``infeasible``: the whole region violates it; the step can only lower the cost
"""

TINY: Final = 1e-12
"""Lengths below this count as zero."""
TOUCHING: Final = 1e-9
"""Tolerance for a constraint that touches the trust region, relative to its size."""
MIN_MULTIPLIER_RATIO: Final = 1e-4
"""Minimum multiplier of the trust region, relative to that of the unconstrained step."""


def solve(
    product: Callable[[th.Tensor], th.Tensor], right: th.Tensor, iterations: int
) -> th.Tensor:
    """Solve H x = right by conjugate gradients.

    The right side is scaled to length 1 first: sb3-contrib's solver stops at an absolute residual
    and starts from noise of fixed size, both of which would exceed a small gradient.

    :param product: of H with a vector.
    :param right: (n,).
    :param iterations: maximum number.
    :return: (n,) x; zero for a zero right side.
    """
    length = th.linalg.vector_norm(right)
    if float(length) < TINY:
        return th.zeros_like(right)
    unit = conjugate_gradient_solver(product, right / length, max_iter=iterations)
    return unit * length


@dataclass(frozen=True)
class Step:
    """The best step as a combination of x = H^-1 g and p = H^-1 b: ``reward * x - cost * p``.

    :param case: see :data:`Case`.
    :param reward: weight of x, 1 / lambda.
    :param cost: weight of p, nu / lambda.
    """

    case: Case
    reward: float
    cost: float


def best_step(q: float, r: float, s: float, c: float, delta: float) -> Step:
    """Solve for the constrained step analytically.

    With multipliers lambda of the trust region and nu of the constraint the solution is
    x* = (H^-1 g - nu H^-1 b) / lambda, nu = max(0, (r + lambda c) / s), and lambda minimises the
    dual, which is (A / lambda + B lambda) / 2 - r c / s where the constraint is active and
    (q / lambda + 2 delta lambda) / 2 where it is not, A = q - r^2 / s, B = 2 delta - c^2 / s.

    :param q: g' H^-1 g.
    :param r: g' H^-1 b.
    :param s: b' H^-1 b.
    :param c: excess of the constraint at x = 0: cost less limit.
    :param delta: size of the trust region, above 0.
    :return: the weights of the step.
    """
    if s < TINY**2:
        # No step changes the cost.
        return Step("unconstrained", _plain(q, delta), 0.0)
    if abs(c) <= TINY * math.sqrt(2.0 * delta * s):
        c = 0.0
    b = 2.0 * delta - c * c / s
    if b <= TOUCHING * delta:
        if c > 0.0:
            return Step("infeasible", 0.0, math.sqrt(2.0 * delta / s))
        return Step("unconstrained", _plain(q, delta), 0.0)
    case: Case = "recoverable" if c > 0.0 else "feasible"
    a = max(q - r * r / s, 0.0)
    # The constraint is active for lambda below (c < 0) or above (c > 0) this border.
    border = -r / c if c != 0.0 else (math.inf if r > 0.0 else -math.inf)
    low, high = (max(border, 0.0), math.inf) if c > 0.0 else (0.0, max(border, 0.0))
    without = math.sqrt(max(q, 0.0) / (2.0 * delta))
    # At 0 the weights are infinite. If the gradients of reward and cost are almost parallel, the
    # rest of x is rounding error, which a smaller multiplier would amplify.
    least = max(MIN_MULTIPLIER_RATIO * without, TINY)
    candidates: list[tuple[float, float, float]] = []
    if high > 0.0:
        binding = max(min(max(math.sqrt(a / b), low), high), least)
        dual = 0.5 * (a / binding + b * binding) - r * c / s
        candidates.append((dual, binding, max(0.0, (r + binding * c) / s)))
    low, high = (0.0, border) if c > 0.0 else (high, math.inf)
    if high > 0.0 and math.isfinite(low):
        free = max(min(max(without, low), high), least)
        candidates.append((0.5 * q / free + delta * free, free, 0.0))
    _, multiplier, price = min(candidates)
    return Step(case, 1.0 / multiplier, price / multiplier)


def _plain(q: float, delta: float) -> float:
    """Compute the weight of x without an active constraint, at the boundary of the region."""
    return math.sqrt(2.0 * delta / q) if q > TINY**2 else 0.0
