"""Distributions of what differs between episodes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from numbers import Integral, Real
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from saver_envs.validation import require


@dataclass(frozen=True)
class Uniform:
    """Real numbers between two ends, all equally likely.

    :param low: lower end.
    :param high: upper end.
    :raises ValueError: for ends that are not finite numbers, or in the wrong order.
    """

    low: float
    high: float

    #: Its name in JSON and YAML.
    kind: ClassVar[str] = "uniform"

    def __post_init__(self) -> None:
        for name, value in (("low", self.low), ("high", self.high)):
            require(name, value, _is_number(value), "a finite number")
        require("high", self.high, self.high >= self.low, f"at least low, {self.low!r}")

    def at(self, share: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the numbers below which these shares of the draws lie."""
        return np.minimum(self.low + (self.high - self.low) * share, self.high)

    @property
    def ends(self) -> tuple[float, float]:
        """The least and the greatest number."""
        return self.low, self.high

    def as_json(self) -> Any:
        """Return what :func:`parse_distribution` reads."""
        return {self.kind: [_plain(self.low), _plain(self.high)]}


@dataclass(frozen=True)
class LogUniform(Uniform):
    """Positive numbers between two ends whose logarithms are equally likely.

    :param low: lower end, above 0.
    :param high: upper end.
    :raises ValueError: for ends that are not finite numbers above 0, or in the wrong order.
    """

    kind: ClassVar[str] = "log_uniform"

    def __post_init__(self) -> None:
        super().__post_init__()
        require("low", self.low, self.low > 0, "above 0, since its logarithm is drawn")

    def at(self, share: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the numbers below which these shares of the draws lie."""
        low, high = math.log(self.low), math.log(self.high)
        logarithms = low + (high - low) * share
        # NumPy's exponential depends on how many numbers it is given, in the last bit.
        drawn = np.reshape([math.exp(one) for one in logarithms.ravel().tolist()], share.shape)
        return np.clip(drawn, self.low, self.high)


@dataclass(frozen=True)
class Choice:
    """One of several values, all equally likely; a value may be a distribution itself.

    :param values: numbers or distributions, at least one.
    :raises ValueError: for no values, or one that is neither.
    """

    values: tuple[float | Uniform, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", tuple(self.values))
        require("values", self.values, bool(self.values), "at least one")
        for value in self.values:
            known = isinstance(value, Uniform) or _is_number(value)
            require("values", self.values, known, "finite numbers, Uniform or LogUniform")

    def at(self, share: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the numbers that these shares, of all draws, stand for."""
        passed = share * len(self.values)
        chosen = passed.astype(np.intp)
        if self._numbers is not None:
            return self._numbers[chosen]
        drawn = np.empty(share.shape)
        for index, value in enumerate(self.values):
            own = chosen == index
            drawn[own] = value.at(passed[own] - index) if isinstance(value, Uniform) else value
        return drawn

    @property
    def ends(self) -> tuple[float, float]:
        """The least and the greatest number."""
        spans = [
            value.ends if isinstance(value, Uniform) else (float(value), float(value))
            for value in self.values
        ]
        return min(low for low, _ in spans), max(high for _, high in spans)

    @cached_property
    def _numbers(self) -> NDArray[np.float64] | None:
        """The values, if none of them is a distribution: they are drawn in one call."""
        return np.array(self.values, np.float64) if all(map(_is_number, self.values)) else None

    @property
    def whole(self) -> bool:
        """Whether every value is a whole number."""
        return self._numbers is not None and bool((self._numbers % 1 == 0).all())

    def as_json(self) -> Any:
        """Return what :func:`parse_distribution` reads."""
        values = [
            value.as_json() if isinstance(value, Uniform) else _plain(value)
            for value in self.values
        ]
        return values[0] if len(values) == 1 and _is_number(values[0]) else {"choice": values}


Distribution = Uniform | Choice

_KINDS = {one.kind: one for one in (Uniform, LogUniform)}
#: What the messages call valid.
VALID = (
    "a number, [low, high], {uniform: [low, high]}, {log_uniform: [low, high]}, "
    "{choice: [value, ...]}, or a Uniform, LogUniform or Choice"
)


def parse_distribution(name: str, value: Any) -> Distribution:
    """Read a distribution from what YAML and JSON can hold.

    :param name: of the parameter, for messages.
    :param value: see :data:`VALID`.
    :raises ValueError: for anything else; the message says what is valid.
    """
    try:
        if isinstance(value, Distribution):
            return value
        if _is_number(value):
            return Choice((float(value),))
        if isinstance(value, Sequence) and not isinstance(value, str) and len(value) == 2:
            return Uniform(*value)
        if isinstance(value, Mapping) and len(value) == 1:
            kind, content = next(iter(value.items()))
            if kind in _KINDS and isinstance(content, Sequence) and len(content) == 2:
                return _KINDS[kind](*content)
            if kind == "choice" and isinstance(content, Sequence):
                values = [
                    one if _is_number(one) else parse_distribution(name, one) for one in content
                ]
                return Choice(tuple(values))  # type: ignore[arg-type]
    except ValueError as error:
        raise ValueError(f"randomization: {name}: {error}") from error
    raise ValueError(f"randomization: {name}={value!r}: must be {VALID}")


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)


def _plain(value: float) -> float:
    """Return a number of Python for one of NumPy."""
    return int(value) if isinstance(value, Integral) else float(value)
