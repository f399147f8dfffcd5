"""The constrained step against numerical solutions of the same problem."""

from __future__ import annotations

import numpy as np
import pytest
import torch as th
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from saver_advisors.safe_baselines.trust_region import best_step, solve


def random_problem(seed: int, size: int):
    """A positive definite matrix and two gradients."""
    random = np.random.default_rng(seed)
    root = random.normal(size=(size, size))
    matrix = root @ root.T / size + 0.1 * np.eye(size)
    return matrix, random.normal(size=size), random.normal(size=size), random


@pytest.mark.parametrize("scale", [1e-7, 1.0, 1e5])
def test_conjugate_gradients_solve_what_numpy_solves(scale):
    matrix, right, _, _ = random_problem(3, 12)
    tensor = th.as_tensor(matrix)
    th.manual_seed(0)
    found = solve(lambda v: tensor @ v, th.as_tensor(scale * right), 50)
    expected = np.linalg.solve(matrix, scale * right)
    np.testing.assert_allclose(found.numpy(), expected, rtol=1e-3, atol=1e-4 * scale)


def test_nothing_to_solve_gives_no_direction():
    found = solve(lambda v: 2 * v, th.zeros(4), 10)
    assert found.tolist() == [0.0] * 4


def brute_force(g, b, c, delta):
    """max g'x under c + b'x <= 0 and x'x <= 2 delta, by walking round the feasible set's border.

    With H = I, to which every problem can be brought, the solution lies in the plane of g and b.
    The maximum of a linear function over a convex set is on its border: the circle, or the chord
    that the constraint cuts off.
    """
    first = b / np.linalg.norm(b)
    rest = g - (g @ first) * first
    second = rest / np.linalg.norm(rest)
    radius = np.sqrt(2 * delta)

    def reward(point):
        return (g @ first) * point[0] + (g @ second) * point[1]

    edge = -c / np.linalg.norm(b)  # the constraint reads: first coordinate <= edge
    angles = np.linspace(0, 2 * np.pi, 5001)
    circle = radius * np.stack((np.cos(angles), np.sin(angles)))
    values = [reward(circle[:, circle[0] <= edge + 1e-12]).max(initial=-np.inf)]
    if abs(edge) < radius:
        half = np.sqrt(radius**2 - edge**2)
        values += [reward((edge, half)), reward((edge, -half))]
    return max(values)


@settings(deadline=None, max_examples=100)
@given(
    seed=st.integers(0, 2**31),
    size=st.integers(2, 8),
    delta=st.sampled_from([1e-3, 1e-2, 1.0]),
    share=st.floats(-2.0, 2.0).filter(lambda share: share == 0.0 or abs(share) > 1e-6),
)
def test_the_step_is_the_best_of_the_feasible_set(seed, size, delta, share):
    matrix, g, b, _ = random_problem(seed, size)
    x, p = np.linalg.solve(matrix, g), np.linalg.solve(matrix, b)
    q, r, s = g @ x, g @ p, b @ p
    # From well inside the constraint to beyond what the trust region reaches.
    c = share * np.sqrt(2 * delta * s)
    step = best_step(q, r, s, c, delta)
    move = step.reward * x - step.cost * p
    length, change = move @ matrix @ move / 2, b @ move
    assert length <= delta * (1 + 1e-6)
    if share >= 1.0:
        assert step.case == ("infeasible" if share > 1.0 else step.case)
        # Nothing is feasible: the cost is brought down as far as the region reaches.
        np.testing.assert_allclose(change, -np.sqrt(2 * delta * s), rtol=1e-6)
        return
    assert step.case == (
        "unconstrained" if share <= -1.0 else "feasible" if share <= 0.0 else "recoverable"
    )
    assert c + change <= 1e-6 * np.sqrt(2 * delta * s)
    # The same problem in coordinates in which the trust region is a ball.
    lower = np.linalg.cholesky(matrix)
    best = brute_force(np.linalg.solve(lower, g), np.linalg.solve(lower, b), c, delta)
    scale = np.sqrt(2 * delta * q)
    np.testing.assert_allclose(g @ move, best, atol=2e-3 * scale)


def test_a_reward_gradient_along_the_cost_gradient_leaves_no_large_weights():
    """What is left of x beside p is rounding, which a small multiplier would blow up."""
    b = np.array([1.0, 2.0])
    for factor in (1.0, -1.0, 3.0):
        g = factor * b
        step = best_step(g @ g, g @ b, b @ b, 0.05, 0.01)
        move = step.reward * g - step.cost * b
        assert abs(step.reward) * np.linalg.norm(g) < 1e4
        assert 0.05 + b @ move <= 1e-9
        assert move @ move / 2 <= 0.01 * (1 + 1e-6)


@pytest.mark.parametrize(
    ("q", "r", "s", "c"),
    [
        (1.0, 0.0, 0.0, -1.0),  # costs that no step changes
        (1.0, 0.0, 0.0, 1.0),
        (1.0, 0.0, 1.0, 0.0),  # on the border, and reward along it
        (1.0, -0.5, 1.0, 0.0),
        (1.0, 0.5, 1.0, 0.0),
        (1.0, 1.0, 1.0, -0.1),  # reward is cost
        (1.0, -1.0, 1.0, 0.1),
    ],
)
def test_borderline_cases_stay_in_the_region(q, r, s, c):
    delta = 0.02
    step = best_step(q, r, s, c, delta)
    length = step.reward**2 * q - 2 * step.reward * step.cost * r + step.cost**2 * s
    change = step.reward * r - step.cost * s
    assert length / 2 <= delta * (1 + 1e-6)
    assert c + change <= 1e-6 or (s == 0.0 and change == 0.0)
    assert step.reward * q - step.cost * r >= -1e-9 or c > 0


def test_no_gradient_at_all_is_no_step():
    assert best_step(0.0, 0.0, 0.0, -1.0, 0.01).reward == 0.0
    only_cost = best_step(0.0, 0.0, 4.0, 0.1, 0.01)
    assert only_cost.reward * 0.0 - only_cost.cost * 4.0 == pytest.approx(-0.1)


def test_the_multiplier_minimises_the_dual():
    """Against a numerical minimum of the dual over both multipliers."""
    q, r, s, c, delta = 2.0, 0.7, 1.5, 0.05, 0.01

    def dual(multiplier: float) -> float:
        price = max(0.0, (r + multiplier * c) / s)
        squared = q - 2 * price * r + price**2 * s
        return squared / (2 * multiplier) - price * c + multiplier * delta

    expected = minimize_scalar(dual, bounds=(1e-3, 1e3), method="bounded").x
    found = 1 / best_step(q, r, s, c, delta).reward
    assert found == pytest.approx(expected, rel=1e-3)
