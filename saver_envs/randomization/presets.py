"""Which parameters an environment varies, and how: from a preset's name or a mapping."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saver_envs.randomization.distributions import Distribution
from saver_envs.randomization.parameters import Parameter

#: Name -> (k, size) values of k episodes.
Values = dict[str, NDArray[np.float64]]

PRESETS = ("none", "mild", "wide")
HELD_OUT = "held-out:"
ALL = "all"


@dataclass(frozen=True)
class Randomization:
    """What differs between episodes.

    :param varied: each parameter with its distribution, in the order in which they are drawn.
    """

    varied: tuple[tuple[Parameter, Distribution], ...] = ()

    def __bool__(self) -> bool:
        return bool(self.varied)

    def distribution_of(self, name: str) -> Distribution | None:
        """Return the distribution of a parameter, or ``None`` if it does not vary."""
        return next((one for parameter, one in self.varied if parameter.name == name), None)

    def greatest(self, name: str) -> float:
        """Return the greatest value that a parameter may have, or 0 if it does not vary."""
        distribution = self.distribution_of(name)
        return 0.0 if distribution is None else distribution.ends[1]

    def empty(self, n: int, n_arms: int) -> Values:
        """Return the arrays (n, size) of the values of n episodes."""
        return {one.name: np.zeros((n, _size(one, n_arms))) for one, _ in self.varied}

    def draw(self, generators: Sequence[np.random.Generator], n_arms: int) -> Values:
        """Draw the values (k, size) of k episodes.

        Constants need no random numbers, so that they leave the starts as they are.

        :param generators: of the k episodes.
        :param n_arms: number of arms.
        """
        sizes = [0 if one.ends[0] == one.ends[1] else _size(of, n_arms) for of, one in self.varied]
        shares = np.stack([generator.random(sum(sizes)) for generator in generators])
        parts = np.split(shares, np.cumsum(sizes)[:-1], axis=1)
        return {
            of.name: distribution.at(part)
            if size
            else np.full((len(shares), _size(of, n_arms)), distribution.ends[0])
            for (of, distribution), size, part in zip(self.varied, sizes, parts, strict=True)
        }

    def as_json(self) -> dict[str, Any]:
        """Return the mapping that :func:`parse_randomization` reads."""
        return {one.name: one.as_json(distribution) for one, distribution in self.varied}


#: All worlds are alike.
NO_RANDOMIZATION = Randomization()


def _size(parameter: Parameter, n_arms: int) -> int:
    return parameter.size * (n_arms if parameter.per_arm else 1)


def parse_randomization(value: Any, known: Sequence[Parameter]) -> Randomization:
    """Return what the option ``randomization`` of an environment says.

    :param value: ``none``, ``mild``, ``wide``, ``held-out:NAME``, ``held-out:all``, or a mapping of
        names to distributions or numbers; ``None`` is ``none``.
    :param known: the parameters of the environment.
    :raises ValueError: for an unknown name, or a distribution that the simulation cannot do.
    """
    by_name = {one.name: one for one in known}
    if value is None or (isinstance(value, str) and value == "none"):
        return NO_RANDOMIZATION
    if isinstance(value, Randomization):
        value = value.as_json()
    if isinstance(value, Mapping):
        for name in value:
            if name not in by_name:
                raise ValueError(
                    f"randomization: {name!r} is not a parameter of this environment; valid names "
                    f"are {', '.join(by_name)}"
                )
        chosen = {name: by_name[name].parse(one) for name, one in value.items()}
    elif isinstance(value, str) and value in PRESETS:
        chosen = {one.name: getattr(one, value) for one in known if one.wide is not None}
    elif isinstance(value, str) and value.startswith(HELD_OUT):
        chosen = _held_out(value, known)
    else:
        raise ValueError(
            f"randomization={value!r}: must be one of {', '.join(PRESETS)}, "
            f"{HELD_OUT}NAME, {HELD_OUT}{ALL}, or a mapping of names to distributions"
        )
    return Randomization(tuple((one, chosen[one.name]) for one in known if one.name in chosen))


def plain_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return keyword arguments of an environment as JSON and YAML can hold them.

    :param options: of which ``randomization`` may have distributions.
    """
    value = options.get("randomization")
    if isinstance(value, Randomization):
        return {**options, "randomization": value.as_json()}
    if isinstance(value, Mapping):
        plain = {
            name: one.as_json() if isinstance(one, Distribution) else one
            for name, one in value.items()
        }
        return {**options, "randomization": plain}
    return dict(options)


def _held_out(value: str, known: Sequence[Parameter]) -> dict[str, Distribution]:
    """Return the distributions that ``held-out:NAME`` means."""
    ranges = {one.name: one.held_out for one in known if one.held_out is not None}
    name = value.removeprefix(HELD_OUT)
    if name == ALL:
        return ranges
    if name not in ranges:
        raise ValueError(
            f"randomization={value!r}: this environment has held-out ranges of "
            f"{', '.join(ranges)}, and {HELD_OUT}{ALL}"
        )
    return {name: ranges[name]}
