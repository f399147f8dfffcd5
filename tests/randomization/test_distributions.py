"""Distributions draw within their ends, survive JSON, and refuse what is none."""

from __future__ import annotations

import json
import math
import re
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from saver_envs.randomization import Choice, LogUniform, Uniform
from saver_envs.randomization.distributions import Distribution, parse_distribution

NUMBERS = st.floats(-1e6, 1e6)


def uniforms(kind: type[Any], numbers: st.SearchStrategy[float]) -> st.SearchStrategy[Any]:
    pairs = st.tuples(numbers, numbers).map(sorted)
    return pairs.map(lambda ends: kind(*ends))


SPANS = st.one_of(uniforms(Uniform, NUMBERS), uniforms(LogUniform, st.floats(1e-6, 1e6)))
CHOICES = st.lists(st.one_of(NUMBERS, st.integers(-9, 9), SPANS), min_size=1, max_size=4).map(
    lambda values: Choice(tuple(values))
)
DISTRIBUTIONS = st.one_of(SPANS, CHOICES)


@given(DISTRIBUTIONS, st.integers(0, 2**31))
@settings(deadline=None, derandomize=True)
def test_draws_lie_within_the_ends(distribution: Distribution, seed: int) -> None:
    drawn = distribution.at(np.random.default_rng(seed).random(20))
    low, high = distribution.ends
    assert drawn.shape == (20,)
    assert drawn.dtype == np.float64
    assert (low <= drawn).all()
    assert (drawn <= high).all()


@given(DISTRIBUTIONS)
@settings(deadline=None, derandomize=True)
def test_json_and_yaml_give_it_back(distribution: Distribution) -> None:
    text = json.dumps(distribution.as_json())
    for content in (json.loads(text), yaml.safe_load(yaml.safe_dump(distribution.as_json()))):
        again = parse_distribution("x", content)
        assert again.as_json() == distribution.as_json()
        assert again.ends == distribution.ends
        one, other = (d.at(np.random.default_rng(0).random(9)) for d in (distribution, again))
        np.testing.assert_array_equal(one, other)


def test_numpys_numbers_become_pythons() -> None:
    one: Any = np.int64(1)
    three: Any = np.int64(3)
    given = Choice((one, Uniform(np.float64(2), three)))
    assert json.dumps(given.as_json()) == '{"choice": [1, {"uniform": [2.0, 3]}]}'


def test_moments() -> None:
    generator, n = np.random.default_rng(0), 20_000
    uniform = Uniform(2, 6).at(generator.random(n))
    assert uniform.mean() == pytest.approx(4, abs=0.05)
    assert uniform.std() == pytest.approx(4 / math.sqrt(12), rel=0.02)
    logarithms = np.log(LogUniform(0.1, 10).at(generator.random(n)))
    assert logarithms.mean() == pytest.approx(0, abs=0.05)
    assert logarithms.std() == pytest.approx(math.log(100) / math.sqrt(12), rel=0.02)
    chosen = Choice((0, 1, Uniform(5, 6))).at(generator.random(n))
    for share in ((chosen == 0).mean(), (chosen == 1).mean(), (chosen >= 5).mean()):
        assert share == pytest.approx(1 / 3, abs=0.02)


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (3, Choice((3.0,))),
        (np.float32(0.5), Choice((0.5,))),
        ([1, 2], Uniform(1, 2)),
        ((1, 2), Uniform(1, 2)),
        ({"uniform": [1, 2]}, Uniform(1, 2)),
        ({"log_uniform": [1, 2]}, LogUniform(1, 2)),
        (
            {"choice": [0, [1, 2], {"log_uniform": [3, 4]}]},
            Choice((0, Uniform(1, 2), LogUniform(3, 4))),
        ),
        (Choice((1, 2)), Choice((1, 2))),
    ],
)
def test_what_can_be_written(value: Any, expected: Distribution) -> None:
    assert parse_distribution("x", value) == expected


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("wide", "randomization: x='wide': must be a number, [low, high], {uniform:"),
        (True, "randomization: x=True: must be a number, [low, high]"),
        (None, "randomization: x=None: must be a number"),
        (math.nan, "randomization: x=nan: must be a number"),
        ([1, 2, 3], "randomization: x=[1, 2, 3]: must be a number, [low, high]"),
        ({"gaussian": [0, 1]}, "{'gaussian': [0, 1]}: must be a number"),
        ({"uniform": [0, 1], "choice": [1]}, "must be a number, [low, high]"),
        ({"uniform": 3}, "{'uniform': 3}: must be a number"),
        ([2, 1], "randomization: x: high=1: must be at least low, 2"),
        ([0, math.inf], "randomization: x: high=inf: must be a finite number"),
        (["0", 1], "randomization: x: low='0': must be a finite number"),
        ({"log_uniform": [0, 1]}, "x: low=0: must be above 0, since its logarithm is drawn"),
        ({"choice": []}, "x: values=(): must be at least one"),
        ({"choice": [1, "two"]}, "randomization: x='two': must be a number"),
        ({"choice": [{"choice": [1, 2]}]}, "must be finite numbers, Uniform or LogUniform"),
    ],
)
def test_what_cannot_be_is_refused(value: Any, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        parse_distribution("x", value)
